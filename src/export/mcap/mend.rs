//! Mends a file that has no end.

use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use mcap::write::NoSeek;

use super::{io_error, options};
use crate::files::output::{Existing, NewFile, WriteError};

/// Copies all messages of whole chunks, and gives how many. Where the file is damaged, that is where
/// it ends.
///
/// # Errors
/// What the disk says of the copy.
pub fn mend<W: Write>(damaged: impl Read, out: W) -> io::Result<(u64, W)> {
    // A chunk that was not written to its end is left out as a whole.
    let reading = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true);
    let mut writer = options().create(NoSeek::new(out)).map_err(io_error)?;
    let mut messages = 0;
    for message in MessageReader::new_with_options(damaged, reading).map_while(Result::ok) {
        writer.write(&message).map_err(io_error)?;
        messages += 1;
    }
    writer.finish().map_err(io_error)?;
    let mut out = writer.into_inner().into_inner();
    out.flush()?;
    Ok((messages, out))
}

/// Mends a file under a new name, which must be free, and removes the damaged one when the mended
/// one is on the disk. Gives the messages in it.
///
/// # Errors
/// [`WriteError`]: the damaged file cannot be read, or the new one not be written; then the damaged
/// one stays.
pub fn mend_file(damaged: &Path, mended: &Path) -> Result<u64, WriteError> {
    let failed = |cause| WriteError::file(mended, cause);
    let source = File::open(damaged).map_err(|cause| WriteError::file(damaged, cause))?;
    // `mended` with `.part` may be the damaged file itself.
    let mut copy = mended.as_os_str().to_owned();
    copy.push(".mended");
    let copy = Path::new(&copy);
    let (file, new) = NewFile::create(copy, Existing::Replace)?;
    let (messages, out) = mend(BufReader::new(source), BufWriter::new(file)).map_err(failed)?;
    out.get_ref().sync_data().map_err(failed)?;
    new.commit()?;
    // Unlike a rename, a link never replaces a file.
    fs::hard_link(copy, mended).map_err(failed)?;
    for old in [copy, damaged] {
        fs::remove_file(old).map_err(failed)?;
    }
    Ok(messages)
}
