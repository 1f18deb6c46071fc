//! A TCP proxy that passes everything on and records the bytes of the server.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;

/// Bytes of the server over one connection.
type ReceivedBytes = Arc<Mutex<Vec<u8>>>;

pub struct Tap {
    pub address: SocketAddr,
    received: Arc<Mutex<Vec<ReceivedBytes>>>,
    is_over: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Tap {
    /// A proxy in front of the server at `to`.
    pub fn in_front_of(to: SocketAddr) -> Tap {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let (received, is_over) = (Arc::<Mutex<Vec<ReceivedBytes>>>::default(), Arc::<AtomicBool>::default());
        let (all, done) = (received.clone(), is_over.clone());
        let thread = thread::spawn(move || {
            let mut passing = Vec::new();
            for client in listener.incoming() {
                if done.load(Ordering::Relaxed) {
                    break;
                }
                let (client, server) = (client.unwrap(), TcpStream::connect(to).unwrap());
                let received = ReceivedBytes::default();
                all.lock().unwrap().push(received.clone());
                let (up, down) = (client.try_clone().unwrap(), server.try_clone().unwrap());
                passing.push(thread::spawn(move || pass(up, server, None)));
                passing.push(thread::spawn(move || pass(down, client, Some(&received))));
            }
            passing.into_iter().for_each(|handle| handle.join().unwrap());
        });
        Tap { address, received, is_over, thread: Some(thread) }
    }

    /// Bytes of the server, connection by connection, when all of them have ended.
    pub fn received(mut self) -> Vec<Vec<u8>> {
        self.is_over.store(true, Ordering::Relaxed);
        drop(TcpStream::connect(self.address));
        self.thread.take().unwrap().join().unwrap();
        self.received.lock().unwrap().iter().map(|bytes| bytes.lock().unwrap().clone()).collect()
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
