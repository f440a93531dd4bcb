//! Memory for sweeps: on the heap here, shared memory elsewhere.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use crate::sweep::layout::ALIGN;

/// Gives out slices to build sweeps in.
pub trait Buffers {
    /// One slice, aligned to [`crate::sweep::layout::ALIGN`], with arbitrary content.
    type Buffer: AsRef<[u8]> + AsMut<[u8]>;

    /// A slice of at least `bytes` bytes.
    fn take(&mut self, bytes: usize) -> Self::Buffer;
}

/// Slices on the heap. A dropped slice is reused, so that a steady stream of sweeps does not
/// allocate.
#[derive(Clone, Debug, Default)]
pub struct HeapBuffers {
    free: Arc<Mutex<Vec<Vec<u8>>>>,
}

/// A slice on the heap.
#[derive(Debug)]
pub struct HeapBuffer {
    bytes: Vec<u8>,
    /// Where it is aligned.
    start: usize,
    home: Arc<Mutex<Vec<Vec<u8>>>>,
}

impl Buffers for HeapBuffers {
    type Buffer = HeapBuffer;

    fn take(&mut self, bytes: usize) -> HeapBuffer {
        let count = bytes + ALIGN - 1;
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let fitting = free.iter().position(|bytes| bytes.len() >= count);
        // Zeroed pages take no memory until they are touched, so that unused capacity is free. That
        // holds for bytes: the allocator writes zeroes itself where it is asked for more alignment.
        let bytes = fitting.map_or_else(|| vec![0; count], |index| free.swap_remove(index));
        HeapBuffer {
            start: bytes.as_ptr().align_offset(ALIGN),
            bytes,
            home: Arc::clone(&self.free),
        }
    }
}

impl HeapBuffer {
    /// As many bytes wherever it is aligned.
    fn range(&self) -> Range<usize> {
        self.start..self.start + self.bytes.len() - (ALIGN - 1)
    }
}

impl AsRef<[u8]> for HeapBuffer {
    fn as_ref(&self) -> &[u8] {
        &self.bytes[self.range()]
    }
}

impl AsMut<[u8]> for HeapBuffer {
    fn as_mut(&mut self) -> &mut [u8] {
        let range = self.range();
        &mut self.bytes[range]
    }
}

impl Drop for HeapBuffer {
    fn drop(&mut self) {
        let bytes = std::mem::take(&mut self.bytes);
        self.home
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(bytes);
    }
}

/// Memory for the sweeps of one sensor: the buffer of the open sweep, and the source of the next.
/// It outlives pipelines: the sensor's next pipeline uses it too.
#[derive(Debug)]
pub struct Memory<B: Buffers> {
    buffers: B,
    open: Option<B::Buffer>,
}

impl<B: Buffers + Default> Default for Memory<B> {
    fn default() -> Self {
        Self::new(B::default())
    }
}

impl<B: Buffers> Memory<B> {
    /// Memory from these buffers.
    pub fn new(buffers: B) -> Self {
        Self {
            buffers,
            open: None,
        }
    }

    /// Takes out the buffer of the complete sweep.
    pub(crate) fn finish(&mut self) -> Option<B::Buffer> {
        self.open.take()
    }
}

/// The buffer that is being filled, whatever its type.
pub trait OpenBuffer {
    /// Takes a buffer of at least `bytes` bytes for a new sweep, and drops the one before.
    fn begin(&mut self, bytes: usize) -> &mut [u8];

    /// The bytes of the open sweep; empty before the first.
    fn bytes(&mut self) -> &mut [u8];
}

impl<B: Buffers> OpenBuffer for Memory<B> {
    fn begin(&mut self, bytes: usize) -> &mut [u8] {
        // Dropped first, so that a pool needs no room for both.
        self.open = None;
        self.open.insert(self.buffers.take(bytes)).as_mut()
    }

    fn bytes(&mut self) -> &mut [u8] {
        self.open.as_mut().map_or(&mut [], AsMut::as_mut)
    }
}
