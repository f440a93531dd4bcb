//! Tests of one program run side by side, as most of them wait; one that measures time runs alone.

use std::cell::RefCell;
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::thread;

static POOL: RwLock<()> = RwLock::new(());

thread_local! {
    static HELD: RefCell<Held> = const { RefCell::new(Held::Nothing) };
}

/// Part of the pool that the test of this thread holds.
enum Held {
    Nothing,
    Shared {
        _until_it_ends: RwLockReadGuard<'static, ()>,
    },
    Alone,
}

/// Right of a test to be the only one that holds the pool.
pub struct Alone {
    _pool: RwLockWriteGuard<'static, ()>,
}

/// Waits until no other test of this program runs that shares the pool. A test that measures time begins with
/// it; a second call in one that is alone never returns.
pub fn alone() -> Alone {
    HELD.set(Held::Nothing);
    let pool = POOL.write().unwrap_or_else(PoisonError::into_inner);
    HELD.set(Held::Alone);
    Alone { _pool: pool }
}

impl Drop for Alone {
    fn drop(&mut self) {
        HELD.set(Held::Nothing);
    }
}

/// Waits while a test is alone, and keeps others from being alone until this test ends. What starts a program, or makes
/// what one needs, calls it.
pub fn share() {
    HELD.with_borrow_mut(|held| {
        if matches!(held, Held::Nothing) && is_of_a_test() {
            *held = Held::Shared {
                _until_it_ends: POOL.read().unwrap_or_else(PoisonError::into_inner),
            };
        }
    });
}

/// True on the thread of a test, which libtest gives the name of the test. Threads that this one starts share its part.
fn is_of_a_test() -> bool {
    let thread = thread::current();
    thread.name().is_some_and(|name| name.contains("::"))
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{self, RecvTimeoutError};
    use std::time::Duration;

    use super::*;

    /// Starts what a test does; says when it has begun, and waits to be told to end.
    fn test(begin: fn() -> Option<Alone>) -> (mpsc::Receiver<()>, mpsc::Sender<()>) {
        let (begun, has_begun) = mpsc::channel();
        let (end, is_over) = mpsc::channel();
        let body = move || {
            let _alone = begin();
            begun.send(()).unwrap();
            let _ = is_over.recv();
        };
        thread::Builder::new()
            .name("pool::one".to_owned())
            .spawn(body)
            .unwrap();
        (has_begun, end)
    }

    fn shares() -> Option<Alone> {
        share();
        share();
        None
    }

    fn is_alone() -> Option<Alone> {
        share();
        let alone = alone();
        share();
        Some(alone)
    }

    #[test]
    fn those_that_share_run_side_by_side_and_one_alone_without_them() {
        let waits = |begun: &mpsc::Receiver<()>| {
            assert_eq!(
                begun.recv_timeout(Duration::from_millis(50)),
                Err(RecvTimeoutError::Timeout)
            );
        };
        let ((first, end_first), (second, end_second)) = (test(shares), test(shares));
        first.recv().unwrap();
        second.recv().unwrap();
        let (third, end_third) = test(is_alone);
        waits(&third);
        drop(end_first);
        waits(&third);
        drop(end_second);
        third.recv().unwrap();
        let (fourth, _end_fourth) = test(shares);
        waits(&fourth);
        drop(end_third);
        fourth.recv().unwrap();
    }
}
