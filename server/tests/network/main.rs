//! The server over real sockets, in one program: it links once.

mod bytes;
mod conformance;
mod front;
mod http;
mod live;
mod mistakes;
mod net;
mod openenv;
mod parsers;
mod protocol;
mod raw;
mod resume;
mod serve;
mod upload;
