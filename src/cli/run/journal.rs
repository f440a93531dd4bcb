//! Log lines in the format of the journal.

use std::fmt;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use tracing::{Event, Level, Subscriber};
use tracing_subscriber::fmt::format::{Compact, Format, Writer};
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields, format};
use tracing_subscriber::registry::LookupSpan;

/// Whether standard error goes to the journal (systemd.exec(5)). The variable alone is not enough,
/// since terminals may inherit it.
pub fn hears_stderr() -> bool {
    std::env::var("JOURNAL_STREAM")
        .is_ok_and(|stream| is_stream(Path::new("/proc/self/fd/2"), &stream))
}

fn is_stream(path: &Path, stream: &str) -> bool {
    fs::metadata(path).is_ok_and(|file| stream == format!("{}:{}", file.dev(), file.ino()))
}

/// Lines without a time, which the journal adds, that begin with their priority (sd-daemon(3)), so
/// that `journalctl -p warning` selects by it.
pub struct Prioritised(Format<Compact, ()>);

impl Default for Prioritised {
    fn default() -> Self {
        Self(
            format()
                .compact()
                .without_time()
                .with_target(false)
                .with_ansi(false),
        )
    }
}

impl<S, N> FormatEvent<S, N> for Prioritised
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut line: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let priority = match *event.metadata().level() {
            Level::ERROR => 3,
            Level::WARN => 4,
            Level::INFO => 6,
            Level::DEBUG | Level::TRACE => 7,
        };
        write!(line, "<{priority}>")?;
        self.0.format_event(context, line, event)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{self, Write};
    use std::sync::{Arc, Mutex};

    struct Lines(Arc<Mutex<Vec<u8>>>);

    impl Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn only_the_very_stream_is_the_journal() {
        let null = fs::metadata("/dev/null").unwrap();
        let (device, inode) = (null.dev(), null.ino());
        let is_null = |stream: String| is_stream(Path::new("/dev/null"), &stream);
        assert!(is_null(format!("{device}:{inode}")));
        assert!(!is_null(format!("{device}:{}", inode + 1)) && !is_null(String::new()));
        assert!(!is_stream(Path::new("/dev/nothing"), "0:0"));
    }

    #[test]
    fn lines_begin_with_their_priority() {
        let written = Arc::new(Mutex::new(Vec::new()));
        let writer = Arc::clone(&written);
        let lines = tracing_subscriber::fmt().with_writer(move || Lines(Arc::clone(&writer)));
        tracing::subscriber::with_default(
            lines.event_format(Prioritised::default()).finish(),
            || {
                tracing::error!("port 2368 hangs");
                tracing::warn!("roof: no packets");
                tracing::info!("roof: streaming");
            },
        );
        let text = String::from_utf8(written.lock().unwrap().clone()).unwrap();
        assert_eq!(
            text,
            "<3>ERROR port 2368 hangs\n<4> WARN roof: no packets\n<6> INFO roof: streaming\n"
        );
    }
}
