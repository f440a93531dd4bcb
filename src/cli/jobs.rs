//! Parallel work on items, with the results in the order of the items.
//!
//! ```text
//!          items 0, 3, 6 ──> job 0 ──┐
//! push ──> items 1, 4, 7 ──> job 1 ──┼──> sink: 0, 1, 2, 3, ...
//!          items 2, 5, 8 ──> job 2 ──┘
//! ```
//!
//! Jobs get items in turn, so that the sink knows which of them has the next result. A job holds at
//! most three items: one that waits, one that it works on, and one whose result waits for its turn.

use std::num::NonZero;
use std::panic::resume_unwind;
use std::sync::mpsc::{self, SyncSender};
use std::thread::{self, Scope, ScopedJoinHandle};

use super::CliError;

/// Most jobs: more do not help on any machine, and may exceed limits of the system.
const MOST_JOBS: u16 = 256;

/// How many threads work.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct JobOptions {
    /// Threads that segment and write side by side; the output is the same with any number [default:
    /// one for each core]
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

/// Jobs under way.
pub enum Jobs<'scope, T> {
    /// A single job, on the calling thread.
    Here(Box<dyn FnMut(T) -> Result<(), CliError> + 'scope>),
    /// Each on a thread of its own.
    SideBySide(Threads<'scope, T>),
}

/// The threads of several jobs, and that of the sink.
pub struct Threads<'scope, T> {
    /// The ways to the jobs.
    items: Vec<SyncSender<T>>,
    /// The job whose turn it is.
    turn: usize,
    sink: Option<ScopedJoinHandle<'scope, Result<(), CliError>>>,
}

impl<'scope, T: Send + 'scope> Jobs<'scope, T> {
    /// Starts a job for each of `works`, of which there is at least one. The results go to `sink`,
    /// in the order of the items, until it fails.
    ///
    /// # Errors
    /// [`CliError::System`]: a thread cannot be started.
    pub fn start<R: Send + 'scope>(
        scope: &'scope Scope<'scope, '_>,
        mut works: Vec<impl FnMut(T) -> R + Send + 'scope>,
        mut sink: impl FnMut(R) -> Result<(), CliError> + Send + 'scope,
    ) -> Result<Self, CliError> {
        if works.len() == 1
            && let Some(mut work) = works.pop()
        {
            return Ok(Self::Here(Box::new(move |item| sink(work(item)))));
        }
        let mut items = Vec::new();
        let mut results = Vec::new();
        for mut work in works {
            let (item_sender, job_items) = mpsc::sync_channel(1);
            let (job_results, result_receiver) = mpsc::sync_channel(1);
            spawn(scope, move || {
                // Ends after the last item, or when the sink has failed.
                for item in job_items {
                    if job_results.send(work(item)).is_err() {
                        break;
                    }
                }
            })?;
            items.push(item_sender);
            results.push(result_receiver);
        }
        let sink = spawn(scope, move || {
            // The first job without a result in its turn is the one after the last item.
            let mut in_turn = results.iter().cycle().map_while(|job| job.recv().ok());
            in_turn.try_for_each(sink)
        })?;
        Ok(Self::SideBySide(Threads {
            items,
            turn: 0,
            sink: Some(sink),
        }))
    }
}

impl<T> Jobs<'_, T> {
    /// Whether each job has a thread of its own.
    pub fn are_side_by_side(&self) -> bool {
        matches!(self, Self::SideBySide(_))
    }

    /// Gives an item to the next job; blocks while that one has enough.
    ///
    /// # Errors
    /// What the sink failed with, once.
    pub fn push(&mut self, item: T) -> Result<(), CliError> {
        match self {
            Self::Here(work) => work(item),
            Self::SideBySide(threads) => threads.push(item),
        }
    }

    /// Waits until the sink has all results.
    ///
    /// # Errors
    /// As [`Jobs::push`].
    pub fn finish(self) -> Result<(), CliError> {
        match self {
            Self::Here(_) => Ok(()),
            Self::SideBySide(mut threads) => threads.join(),
        }
    }
}

impl<T> Threads<'_, T> {
    fn push(&mut self, item: T) -> Result<(), CliError> {
        let Some(job) = self.items.get(self.turn) else {
            return Ok(());
        };
        self.turn = (self.turn + 1) % self.items.len();
        match job.send(item) {
            Ok(()) => Ok(()),
            // The job has ended: the sink has failed, or the job panicked, which ends the scope.
            Err(_) => self.join(),
        }
    }

    fn join(&mut self) -> Result<(), CliError> {
        self.items.clear();
        match self.sink.take().map(ScopedJoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(panic)) => resume_unwind(panic),
        }
    }
}

fn spawn<'scope, R: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    work: impl FnOnce() -> R + Send + 'scope,
) -> Result<ScopedJoinHandle<'scope, R>, CliError> {
    let builder = thread::Builder::new();
    builder
        .spawn_scoped(scope, work)
        .map_err(|source| CliError::System {
            what: "start a thread",
            source,
        })
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

    #[test]
    fn results_come_in_the_order_of_the_items_and_few_are_under_way() {
        for count in 1..5 {
            let under_way = AtomicUsize::new(0);
            let mut results = Vec::new();
            thread::scope(|scope| {
                let sink = |item| {
                    under_way.fetch_sub(1, Ordering::SeqCst);
                    results.push(item);
                    Ok(())
                };
                let mut jobs = Jobs::start(scope, vec![work; count], sink).unwrap();
                for item in 0..ITEMS {
                    under_way.fetch_add(1, Ordering::SeqCst);
                    jobs.push(item).unwrap();
                    // The sink holds one more.
                    assert!(under_way.load(Ordering::SeqCst) <= 3 * count + 1);
                }
                jobs.finish().unwrap();
            });
            assert!(results.into_iter().eq(0..ITEMS), "{count} jobs");
        }
    }

    #[test]
    fn nothing_comes_after_the_result_that_the_sink_failed_with() {
        for count in 1..4 {
            let mut results = Vec::new();
            let error = thread::scope(|scope| {
                let sink = |item| {
                    results.push(item);
                    match item {
                        50 => Err(CliError::Usage("full".to_owned())),
                        _ => Ok(()),
                    }
                };
                let mut jobs = Jobs::start(scope, vec![work; count], sink).unwrap();
                (0..ITEMS)
                    .try_for_each(|item| jobs.push(item))
                    .and_then(|()| jobs.finish())
                    .unwrap_err()
            });
            assert_eq!(error.to_string(), "full");
            assert!(results.into_iter().eq(0..=50), "{count} jobs");
        }
    }

    #[test]
    #[should_panic(expected = "a scoped thread panicked")]
    fn a_job_that_panics_ends_all() {
        thread::scope(|scope| {
            let work = |item| assert!(item != 50);
            let mut jobs = Jobs::start(scope, vec![work; 3], |()| Ok(())).unwrap();
            (0..ITEMS).try_for_each(|item| jobs.push(item)).unwrap();
            jobs.finish().unwrap();
        });
    }
}
