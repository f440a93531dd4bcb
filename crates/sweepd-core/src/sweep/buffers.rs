//! Where the bytes of a sweep come from: the heap here, shared memory elsewhere.

use std::sync::{Arc, Mutex, PoisonError};

use zerocopy::{FromZeros, IntoBytes};

/// Gives out slices to build sweeps in.
pub trait Buffers {
    /// One slice, aligned to [`super::layout::ALIGN`]; what it holds at first is anything.
    type Buffer: AsRef<[u8]> + AsMut<[u8]>;

    /// A slice of at least `bytes` bytes.
    fn take(&mut self, bytes: usize) -> Self::Buffer;
}

/// Slices on the heap; one that is dropped is given out again, so a steady stream of sweeps
/// allocates nothing.
#[derive(Clone, Debug, Default)]
pub struct HeapBuffers {
    free: Arc<Mutex<Vec<Vec<Line>>>>,
}

/// 64 aligned bytes.
#[derive(
    Clone,
    Copy,
    Debug,
    zerocopy::FromBytes,
    zerocopy::IntoBytes,
    zerocopy::KnownLayout,
    zerocopy::Immutable,
)]
#[repr(C, align(64))]
struct Line([u8; 64]);

/// A slice on the heap.
#[derive(Debug)]
pub struct HeapBuffer {
    lines: Vec<Line>,
    home: Arc<Mutex<Vec<Vec<Line>>>>,
}

impl Buffers for HeapBuffers {
    type Buffer = HeapBuffer;

    fn take(&mut self, bytes: usize) -> HeapBuffer {
        let count = bytes.div_ceil(size_of::<Line>());
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let fitting = free.iter().position(|lines| lines.len() >= count);
        let lines = fitting
            .map(|index| free.swap_remove(index))
            .unwrap_or_else(|| {
                // Zeroed pages are the system's until they are touched: capacity that no sweep
                // fills costs nothing.
                Line::new_vec_zeroed(count).expect("a sweep fits the address space")
            });
        HeapBuffer {
            lines,
            home: Arc::clone(&self.free),
        }
    }
}

impl AsRef<[u8]> for HeapBuffer {
    fn as_ref(&self) -> &[u8] {
        self.lines.as_bytes()
    }
}

impl AsMut<[u8]> for HeapBuffer {
    fn as_mut(&mut self) -> &mut [u8] {
        self.lines.as_mut_bytes()
    }
}

impl Drop for HeapBuffer {
    fn drop(&mut self) {
        let lines = std::mem::take(&mut self.lines);
        self.home
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(lines);
    }
}

/// Buffers that outlive a pipeline: whoever begins another one gives it the same.
#[derive(Debug)]
pub struct Kept<B>(Arc<Mutex<B>>);

impl<B> Kept<B> {
    /// Keeps these.
    pub fn new(buffers: B) -> Self {
        Self(Arc::new(Mutex::new(buffers)))
    }
}

impl<B> Clone for Kept<B> {
    /// The same buffers once more.
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<B: Buffers> Buffers for Kept<B> {
    type Buffer = B::Buffer;

    fn take(&mut self, bytes: usize) -> B::Buffer {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take(bytes)
    }
}
