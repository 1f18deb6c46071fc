//! The server over real sockets, in one program: it links once.

mod conformance;
mod front;
mod live;
mod mistakes;
mod net;
mod openenv;
mod parsers;
mod protocol;
mod raw;
mod resume;
mod serve;
