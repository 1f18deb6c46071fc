//! A TCP proxy that passes everything on and keeps what the server says.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;

/// What the server said over one connection.
type Heard = Arc<Mutex<Vec<u8>>>;

pub struct Tap {
    pub address: SocketAddr,
    heard: Arc<Mutex<Vec<Heard>>>,
    over: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Tap {
    /// Before the server at `to`.
    pub fn before(to: SocketAddr) -> Tap {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let (heard, over) = (Arc::<Mutex<Vec<Heard>>>::default(), Arc::<AtomicBool>::default());
        let (all, done) = (heard.clone(), over.clone());
        let thread = thread::spawn(move || {
            let mut passing = Vec::new();
            for client in listener.incoming() {
                if done.load(Ordering::Relaxed) {
                    break;
                }
                let (client, server) = (client.unwrap(), TcpStream::connect(to).unwrap());
                let heard = Heard::default();
                all.lock().unwrap().push(heard.clone());
                let (up, down) = (client.try_clone().unwrap(), server.try_clone().unwrap());
                passing.push(thread::spawn(move || pass(up, server, None)));
                passing.push(thread::spawn(move || pass(down, client, Some(&heard))));
            }
            passing.into_iter().for_each(|one| one.join().unwrap());
        });
        Tap { address, heard, over, thread: Some(thread) }
    }

    /// What the server said, connection by connection, when all of them have ended.
    pub fn heard(mut self) -> Vec<Vec<u8>> {
        self.over.store(true, Ordering::Relaxed);
        drop(TcpStream::connect(self.address));
        self.thread.take().unwrap().join().unwrap();
        self.heard.lock().unwrap().iter().map(|one| one.lock().unwrap().clone()).collect()
    }
}

fn pass(mut from: TcpStream, mut to: TcpStream, keep: Option<&Mutex<Vec<u8>>>) {
    to.set_nodelay(true).unwrap();
    let mut block = [0; 1 << 16];
    // either end may go at any time
    while let Ok(count @ 1..) = from.read(&mut block) {
        if let Some(keep) = keep {
            keep.lock().unwrap().extend_from_slice(&block[..count]);
        }
        if to.write_all(&block[..count]).is_err() {
            break;
        }
    }
    let _ = from.shutdown(Shutdown::Read);
    let _ = to.shutdown(Shutdown::Write);
}
