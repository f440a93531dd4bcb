//! Sweeps through shared memory.
