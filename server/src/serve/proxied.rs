//! The header in front of a connection that names the client of a proxy: HAProxy's PROXY protocol, versions 1 and 2.

use std::io::{ErrorKind, Result};
use std::net::SocketAddr;
use std::time::Duration;

use ppp::{HeaderResult, PartialResult, v1, v2};
use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;

/// The longest header of version 2 that is read; addresses take at most 232 bytes, further fields follow
/// them. The longest line of version 1.
const MOST_BYTES: usize = 2048;
const MOST_LINE_BYTES: usize = 107;
/// Time between two looks at a header that is not complete.
const LOOK: Duration = Duration::from_millis(5);

/// Reads the header, if there is one; what follows it stays in the stream. None also for a connection of the proxy
/// itself, such as one that looks whether the server is there.
///
/// # Errors
/// A header that is too long or cannot be read; the errors of the stream.
pub(super) async fn client(stream: &mut TcpStream) -> Result<Option<SocketAddr>> {
    let mut head = [0; MOST_BYTES];
    loop {
        let seen = match stream.peek(&mut head).await? {
            0 => return Ok(None),
            count => &head[..count],
        };
        let begins = |prefix: &[u8]| seen.starts_with(prefix) || prefix.starts_with(seen);
        if !begins(v1::PROTOCOL_PREFIX.as_bytes()) && !begins(v2::PROTOCOL_PREFIX) {
            return Ok(None);
        }
        let header = HeaderResult::parse(seen);
        let is_incomplete = match &header {
            // a line that is cut off within a word counts as wrong there
            HeaderResult::V1(_) => {
                seen.len() < MOST_LINE_BYTES && !seen.windows(2).any(|pair| pair == b"\r\n")
            }
            HeaderResult::V2(_) => seen.len() < MOST_BYTES && header.is_incomplete(),
        };
        if is_incomplete {
            tokio::time::sleep(LOOK).await;
            continue;
        }
        let (length, address) = parse(&header).ok_or(ErrorKind::InvalidData)?;
        stream.read_exact(&mut head[..length]).await?;
        return Ok(address);
    }
}

/// Bytes of a header, and the client's address.
fn parse(header: &HeaderResult<'_>) -> Option<(usize, Option<SocketAddr>)> {
    match header {
        HeaderResult::V1(header) => {
            let header = header.as_ref().ok()?;
            let address = match header.addresses {
                v1::Addresses::Tcp4(ip) => Some((ip.source_address, ip.source_port).into()),
                v1::Addresses::Tcp6(ip) => Some((ip.source_address, ip.source_port).into()),
                v1::Addresses::Unknown => None,
            };
            Some((header.header.len(), address))
        }
        HeaderResult::V2(header) => {
            let header = header.as_ref().ok()?;
            let address = match header.addresses {
                _ if header.command == v2::Command::Local => None,
                v2::Addresses::IPv4(ip) => Some((ip.source_address, ip.source_port).into()),
                v2::Addresses::IPv6(ip) => Some((ip.source_address, ip.source_port).into()),
                v2::Addresses::Unspecified | v2::Addresses::Unix(_) => None,
            };
            Some((header.len(), address))
        }
    }
}
