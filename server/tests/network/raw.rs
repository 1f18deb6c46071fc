//! WebSocket octets by hand: what a client library would never send.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};

pub const CONTINUE: u8 = 0;
pub const TEXT: u8 = 1;
pub const BINARY: u8 = 2;
pub const CLOSE: u8 = 8;
pub const PING: u8 = 9;
pub const PONG: u8 = 10;

pub struct Frame {
    opcode: u8,
    payload: Vec<u8>,
    fin: bool,
    rsv: u8,
    masked: bool,
}

pub fn frame(opcode: u8, payload: &[u8]) -> Frame {
    Frame { opcode, payload: payload.to_vec(), fin: true, rsv: 0, masked: true }
}

pub fn close(code: u16, reason: &[u8]) -> Frame {
    frame(CLOSE, &[&code.to_be_bytes(), reason].concat())
}

impl Frame {
    pub fn fin(self, fin: bool) -> Frame {
        Frame { fin, ..self }
    }

    pub fn rsv(self, rsv: u8) -> Frame {
        Frame { rsv, ..self }
    }

    pub fn without_mask(self) -> Frame {
        Frame { masked: false, ..self }
    }

    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![u8::from(self.fin) << 7 | self.rsv << 4 | self.opcode];
        let mask_bit = u8::from(self.masked) << 7;
        match self.payload.len() {
            n @ 0..126 => bytes.push(mask_bit | n as u8),
            n @ 126..65536 => {
                bytes.push(mask_bit | 126);
                bytes.extend((n as u16).to_be_bytes());
            }
            n => {
                bytes.push(mask_bit | 127);
                bytes.extend((n as u64).to_be_bytes());
            }
        }
        if !self.masked {
            bytes.extend(&self.payload);
            return bytes;
        }
        let mask = [0x37, 0xfa, 0x21, 0x3d];
        bytes.extend(mask);
        bytes.extend(self.payload.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
        bytes
    }
}

impl From<Frame> for Vec<u8> {
    fn from(frame: Frame) -> Vec<u8> {
        frame.bytes()
    }
}

/// A message from the server.
#[derive(Debug, Clone, PartialEq)]
pub enum ServerMessage {
    Text(Vec<u8>),
    Binary(Vec<u8>),
    Pong(Vec<u8>),
    /// Some of these in order, the last one among them.
    Pongs(Vec<Vec<u8>>),
}

/// Bytes to send, and the expected messages, up to the end of the connection.
#[derive(Clone)]
pub struct Case {
    pub name: String,
    send: Vec<Vec<u8>>,
    chop: Option<usize>,
    pub hear: Vec<ServerMessage>,
    /// The code of the server's Close; with `None` one without a code.
    close: Option<u16>,
    /// The test closes the connection at the end.
    polite: bool,
    /// Messages before the failure may be lost with the connection.
    lossy: bool,
}

impl Case {
    pub fn new(name: &str) -> Case {
        Case {
            name: name.into(),
            send: vec![],
            chop: None,
            hear: vec![],
            close: Some(1000),
            polite: true,
            lossy: false,
        }
    }

    pub fn with_name(self, name: &str) -> Case {
        Case { name: name.into(), ..self }
    }

    pub fn send(mut self, bytes: impl Into<Vec<u8>>) -> Case {
        self.send.push(bytes.into());
        self
    }

    pub fn hear(mut self, heard: ServerMessage) -> Case {
        self.hear.push(heard);
        self
    }

    /// In writes of so many octets, whatever the frames.
    pub fn chop(self, chop: usize) -> Case {
        Case { chop: Some(chop), ..self }
    }

    pub fn closes(self, code: Option<u16>) -> Case {
        Case { close: code, polite: false, ..self }
    }

    /// The server must end the connection with this code.
    pub fn fails(self, code: u16) -> Case {
        Case { close: Some(code), polite: false, lossy: true, ..self }
    }
}

/// A connection that has been upgraded, by hand.
pub fn connect(address: SocketAddr, protocol: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_nodelay(true).unwrap();
    stream.set_read_timeout(Some(crate::net::PATIENCE)).unwrap();
    write!(
        stream,
        "GET /ws HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: {protocol}\r\n\r\n"
    )
    .unwrap();
    let mut head = vec![];
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte).unwrap();
        head.push(byte[0]);
    }
    let head = String::from_utf8(head).unwrap().to_ascii_lowercase();
    // the example of RFC 6455, 1.3
    assert!(head.starts_with("http/1.1 101") && head.contains("s3pplmbitxaq9kygzzhzrbk+xoo="), "{head}");
    stream
}

/// The next frame: first octet and payload; `None` at the end of the connection.
pub fn read(stream: &mut TcpStream) -> std::io::Result<Option<(u8, Vec<u8>)>> {
    let mut head = [0; 2];
    if stream.read(&mut head[..1])? == 0 {
        return Ok(None);
    }
    stream.read_exact(&mut head[1..])?;
    assert!(head[1] & 0x80 == 0, "a server must not mask");
    let length = match head[1] {
        126 => {
            let mut length = [0; 2];
            stream.read_exact(&mut length)?;
            u64::from(u16::from_be_bytes(length))
        }
        127 => {
            let mut length = [0; 8];
            stream.read_exact(&mut length)?;
            u64::from_be_bytes(length)
        }
        short => u64::from(short),
    };
    let mut payload = vec![0; length as usize];
    stream.read_exact(&mut payload)?;
    Ok(Some((head[0], payload)))
}

/// Plays a case; what went otherwise than it must.
pub fn play(address: SocketAddr, case: &Case) -> Result<(), String> {
    let mut stream = connect(address, "crazyflie.echo.v1");
    let mut writer = stream.try_clone().unwrap();
    let mut send = case.send.clone();
    if case.polite {
        send.push(close(1000, b"").bytes());
    }
    let chop = case.chop;
    let writing = std::thread::spawn(move || {
        let writes: Vec<Vec<u8>> = match chop {
            None => send,
            Some(chop) => send.concat().chunks(chop).map(<[u8]>::to_vec).collect(),
        };
        // a server that has failed the connection hears no more
        writes.iter().try_for_each(|write| writer.write_all(write))
    });
    let mut heard = vec![];
    let closed = loop {
        match read(&mut stream).map_err(|e| format!("no Close: {e}; heard {} frames", heard.len()))? {
            Some((0x88, payload)) => break payload,
            Some((0x81, payload)) => heard.push(ServerMessage::Text(payload)),
            Some((0x82, payload)) => heard.push(ServerMessage::Binary(payload)),
            Some((0x8a, payload)) => heard.push(ServerMessage::Pong(payload)),
            Some((first, _)) => return Err(format!("heard a frame that begins {first:#04x}")),
            None => return Err("the connection ended without Close".into()),
        }
    };
    let _ = stream.shutdown(std::net::Shutdown::Write);
    match read(&mut stream) {
        Ok(None) | Err(_) => {}
        Ok(Some(_)) => return Err("a frame after Close".into()),
    }
    let _ = writing.join().unwrap();
    let code = (closed.len() >= 2).then(|| u16::from_be_bytes([closed[0], closed[1]]));
    if code != case.close {
        return Err(format!("Close {code:?}, expected {:?}", case.close));
    }
    agree(&heard, case)
}

fn agree(heard: &[ServerMessage], case: &Case) -> Result<(), String> {
    if let [ServerMessage::Pongs(all)] = &case.hear[..] {
        let pongs: Vec<&Vec<u8>> = heard
            .iter()
            .filter_map(|h| if let ServerMessage::Pong(p) = h { Some(p) } else { None })
            .collect();
        let mut rest = all.iter();
        let ordered = pongs.iter().all(|pong| rest.any(|p| p == *pong));
        return if ordered && pongs.last().copied() == all.last() {
            Ok(())
        } else {
            Err(format!("heard {heard:?}"))
        };
    }
    let right = if case.lossy { case.hear.starts_with(heard) } else { heard == case.hear };
    if right {
        Ok(())
    } else {
        Err(format!("heard {} frames otherwise than the {} expected", heard.len(), case.hear.len()))
    }
}
