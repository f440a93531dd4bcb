//! Parallel work on items, with the results in the order of the items.
//!
//! ```text
//! job 0   take item 0 │ work on it │ write its result │ take item 3 ...
//! job 1               │ take item 1 │ work on it      │ write its result ...
//! job 2                             │ take item 2 │ work on it         │ ...
//! ```
//!
//! One job at a time takes an item, and one at a time writes, in the order of the items. A job stays
//! with its item from the beginning to the end: what it works on stays in the cache of its core, and
//! there are never more items than jobs.

use std::num::NonZero;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use super::CliError;

/// Most jobs: more do not help on any machine, and may exceed limits of the system.
const MOST_JOBS: u16 = 256;

/// How many threads work.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct JobOptions {
    /// Threads that segment, and make files, side by side; the output is the same with any number
    /// [default: one for each core; one at a given pace, and with --publish]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(MOST_JOBS)))]
    jobs: Option<u16>,
}

impl JobOptions {
    /// How many there are, 1 or more.
    pub fn count(self) -> usize {
        let count = match self.jobs {
            Some(jobs) => jobs.into(),
            None => thread::available_parallelism().map_or(1, NonZero::get),
        };
        count.min(MOST_JOBS.into())
    }
}

/// Takes items until there are none, works on them, and writes the results: a job for each of
/// `works`, the first on this thread. `take` is given the number of its job.
///
/// # Errors
/// The first error in the order of the items, of `take` or `write`; nothing is written behind it.
/// [`CliError::System`]: a thread cannot be started.
pub fn run<T, R>(
    take: impl FnMut(usize) -> Result<Option<T>, CliError> + Send,
    works: Vec<impl FnMut(T) -> R + Send>,
    write: impl FnMut(R) -> Result<(), CliError> + Send,
) -> Result<(), CliError> {
    let jobs = Jobs {
        source: Mutex::new(Source {
            take,
            taken: 0,
            is_over: false,
        }),
        sink: Mutex::new(Sink {
            write,
            written: 0,
            result: Ok(()),
            is_over: false,
        }),
        turn: Condvar::new(),
    };
    thread::scope(|scope| {
        let mut works = works.into_iter().enumerate();
        let own = works.next();
        for (job, work) in works {
            let shared = &jobs;
            let builder = thread::Builder::new();
            let thread = builder.spawn_scoped(scope, move || shared.go_through(job, work));
            if let Err(source) = thread {
                jobs.stop();
                let what = "start a thread";
                return Err(CliError::System { what, source });
            }
        }
        if let Some((job, work)) = own {
            jobs.go_through(job, work);
        }
        Ok(())
    })?;
    let sink = jobs.sink.into_inner();
    sink.unwrap_or_else(PoisonError::into_inner).result
}

/// What all jobs share.
struct Jobs<T, W> {
    source: Mutex<Source<T>>,
    sink: Mutex<Sink<W>>,
    /// Another result may be written, or none any more.
    turn: Condvar,
}

struct Source<T> {
    take: T,
    taken: u64,
    is_over: bool,
}

struct Sink<W> {
    write: W,
    written: u64,
    result: Result<(), CliError>,
    is_over: bool,
}

impl<T, W> Jobs<T, W> {
    /// One job, from its first item to the end of all.
    fn go_through<I, R>(&self, job: usize, mut work: impl FnMut(I) -> R)
    where
        T: FnMut(usize) -> Result<Option<I>, CliError>,
        W: FnMut(R) -> Result<(), CliError>,
    {
        let _stop = StopOnPanic(self);
        while let Some((number, item)) = self.take(job) {
            if !self.write(number, item.map(&mut work)) {
                break;
            }
        }
    }

    /// The next item and its number, or the error in its place.
    fn take<I>(&self, job: usize) -> Option<(u64, Result<I, CliError>)>
    where
        T: FnMut(usize) -> Result<Option<I>, CliError>,
    {
        let mut source = lock(&self.source);
        if source.is_over {
            return None;
        }
        // After a panic of `take`, no other job may call it.
        source.is_over = true;
        let item = (source.take)(job).transpose();
        source.is_over = !matches!(item, Some(Ok(_)));
        source.taken += 1;
        Some((source.taken - 1, item?))
    }

    /// Writes a result when its turn comes; false when nothing is written any more.
    fn write<R>(&self, number: u64, result: Result<R, CliError>) -> bool
    where
        W: FnMut(R) -> Result<(), CliError>,
    {
        let waiting = self.turn.wait_while(lock(&self.sink), |sink| {
            sink.written < number && !sink.is_over
        });
        let mut sink = waiting.unwrap_or_else(PoisonError::into_inner);
        if sink.is_over {
            return false;
        }
        sink.result = result.and_then(|result| (sink.write)(result));
        sink.written += 1;
        sink.is_over = sink.result.is_err();
        self.turn.notify_all();
        !sink.is_over
    }

    /// Has all jobs end after the items that they work on.
    fn stop(&self) {
        lock(&self.sink).is_over = true;
        self.turn.notify_all();
    }
}

/// Ends the other jobs where one panics: its turn will not come.
struct StopOnPanic<'a, T, W>(&'a Jobs<T, W>);

impl<T, W> Drop for StopOnPanic<'_, T, W> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.stop();
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use super::*;

    const ITEMS: usize = 200;

    /// Some items take longer than others.
    fn work(item: usize) -> usize {
        thread::sleep(Duration::from_micros((item * 7 % 5) as u64 * 100));
        item
    }

    fn next(items: &mut impl Iterator<Item = usize>) -> Result<Option<usize>, CliError> {
        Ok(items.next())
    }

    #[test]
    fn results_come_in_the_order_of_the_items_and_there_is_one_a_job() {
        for count in 1..5 {
            let under_way = AtomicUsize::new(0);
            let mut items = 0..ITEMS;
            let take = |_| {
                assert!(under_way.fetch_add(1, Ordering::SeqCst) < count);
                next(&mut items)
            };
            let mut results = Vec::new();
            let write = |item| {
                under_way.fetch_sub(1, Ordering::SeqCst);
                results.push(item);
                Ok(())
            };
            run(take, vec![work; count], write).unwrap();
            assert!(results.into_iter().eq(0..ITEMS), "{count} jobs");
        }
    }

    #[test]
    fn nothing_is_written_behind_an_error() {
        for count in 1..5 {
            for is_of_write in [true, false] {
                let full = || CliError::Failed("full".to_owned());
                let mut items = 0..ITEMS;
                let take = |_| match next(&mut items)? {
                    Some(50) if !is_of_write => Err(full()),
                    item => Ok(item),
                };
                let mut results = Vec::new();
                let write = |item| {
                    if item == 50 {
                        return Err(full());
                    }
                    results.push(item);
                    Ok(())
                };
                let error = run(take, vec![work; count], write).unwrap_err();
                assert_eq!(error.to_string(), "full");
                assert!(results.into_iter().eq(0..50), "{count} jobs");
            }
        }
    }

    #[test]
    #[should_panic]
    fn a_job_that_panics_ends_all() {
        let mut items = 0..ITEMS;
        let work = |item| assert!(item != 50);
        let _ = run(|_| next(&mut items), vec![work; 3], |()| Ok(()));
    }
}
