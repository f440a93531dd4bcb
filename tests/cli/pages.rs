//! The pages of the project: links that lead somewhere.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use sweepd_testkit::root;

/// The pages that people read: those of the root, of docs, and of other folders.
fn pages() -> Vec<PathBuf> {
    let folders = [
        "",
        "docs",
        "docs/lab",
        "calib",
        "pcap_fixtures",
        "tests/fuzz",
    ];
    let files = folders
        .iter()
        .flat_map(|folder| fs::read_dir(root().join(folder)).unwrap());
    files
        .map(|file| file.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect()
}

/// The anchors of a page's headings, as GitHub and mdBook make them.
fn anchors(page: &str) -> BTreeSet<String> {
    page.lines()
        .filter(|line| line.starts_with('#'))
        .map(|line| {
            line.trim_start_matches('#')
                .trim()
                .to_lowercase()
                .chars()
                .filter_map(|one| match one {
                    ' ' => Some('-'),
                    '-' | '_' => Some(one),
                    _ => one.is_alphanumeric().then_some(one),
                })
                .collect()
        })
        .collect()
}

#[test]
fn every_link_leads_to_a_page_and_a_heading() {
    let pages = pages();
    let book = root().join("docs");
    assert!(pages.len() > 15, "{pages:?}");
    let mut dead = Vec::new();
    for page in &pages {
        let text = fs::read_to_string(page).unwrap();
        let links = text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split_once(')'));
        for (link, _) in links.filter(|(link, _)| !link.contains("://")) {
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => page.clone(),
                file => page.with_file_name(file),
            };
            let is_there = if anchor.is_empty() {
                target.exists()
            } else {
                fs::read_to_string(&target).is_ok_and(|text| anchors(&text).contains(anchor))
            };
            // The book holds the pages of docs alone.
            let leaves_the_book = page.starts_with(&book)
                && target
                    .canonicalize()
                    .is_ok_and(|target| !target.starts_with(book.canonicalize().unwrap()));
            if !is_there || leaves_the_book {
                dead.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(dead.is_empty(), "{dead:#?}");
}
