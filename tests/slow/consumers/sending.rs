//! A sensor before which something happens.

use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Instant;

use sweepd_lab::cast::{Scene, Sensor, Spin};

/// No scene: it ends.
const NO_SENSOR: usize = usize::MAX;

/// A sensor on loopback that sends in real time, until this is dropped.
pub struct Sending {
    scene: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
}

impl Sending {
    /// It sees the first of the scenes.
    pub fn new(sensor: Sensor, scenes: Vec<Scene>, port: u16) -> Self {
        let scene = Arc::<AtomicUsize>::default();
        let shown = Arc::clone(&scene);
        let thread = Some(thread::spawn(move || send(&sensor, &scenes, port, &shown)));
        Self { scene, thread }
    }

    /// It sees the scene of this number.
    pub fn show(&self, scene: usize) {
        self.scene.store(scene, Ordering::Relaxed);
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.show(NO_SENSOR);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn send(sensor: &Sensor, scenes: &[Scene], port: u16, shown: &AtomicUsize) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut spin = Spin::new(sensor, &scenes[0]);
    let begun = Instant::now();
    while let Some(scene) = scenes.get(shown.load(Ordering::Relaxed)) {
        spin.look_at(scene);
        let Some((due, packet)) = spin.next() else {
            return;
        };
        thread::sleep(due.saturating_sub(begun.elapsed()));
        socket.send_to(packet.emit(), ("127.0.0.1", port)).unwrap();
    }
}
