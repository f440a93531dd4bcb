//! Asks sensors for their settings, without changing them.

use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use super::observe::Web;
use crate::web_interface::{read, runtime};

/// How long an answer may take.
const PATIENCE: Duration = Duration::from_millis(1500);

/// Asks sensors for their settings, all at once. Those that do not answer are left out.
///
/// # Errors
/// What the system says when it cannot even begin.
pub fn ask(addresses: &[Ipv4Addr], port: u16) -> std::io::Result<Vec<Web>> {
    if addresses.is_empty() {
        return Ok(Vec::new());
    }
    let runtime = runtime()?;
    let mut pages = Vec::new();
    for &address in addresses {
        let to = SocketAddr::from((address, port));
        pages.push((address, runtime.spawn(read(to, PATIENCE))));
    }
    Ok(runtime.block_on(async {
        let mut answers = Vec::new();
        for (address, page) in pages {
            if let Ok(Ok(page)) = page.await {
                answers.push(Web { address, page });
            }
        }
        answers
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_web_page_there_is_no_answer() {
        let free = sweepd_testkit::ReservedPort::new().unwrap();
        assert_eq!(ask(&[Ipv4Addr::LOCALHOST], free.number()).unwrap(), []);
    }
}
