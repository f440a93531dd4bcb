"""What count_lines.py counts in sources whose figures were counted by hand, and how it judges them."""

import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

sys.dont_write_bytecode = True
sys.path.insert(0, str(Path(__file__).parents[1]))
import count_lines

WORKSPACE = """
[workspace]
members = ["crates/*"]
exclude = ["theirs"]
[package]
name = "sweepd"
[dependencies]
theirs = { path = "theirs" }
sweepd-client = { path = "crates/sweepd-client" }
"""
NOTHING = {
    "code-lines": 0,
    "pub-items": 0,
    "long-functions": 0,
    "closures": 0,
    "tuple-lets": 0,
    "array-maps": 0,
    "packed-parameters": 0,
    "unnamed-docs": 0,
    "shared-type-names": 0,
    "comments-per-100-lines": 0.0,
}


def source(text):
    return count_lines.Source(Path("src/lib.rs"), text)


def lines(text, figure):
    return source(text).places[figure]


def code_lines(text):
    return [number for number, is_code in enumerate(source(text).is_code, 1) if is_code]


class Code(unittest.TestCase):
    def test_comments_and_blank_lines_are_no_code(self):
        text = "//! Doc.\n\n/// Doc.\nfn a() {} // why\n/* one /* two\n */ fn no() {}\n*/ fn b() {}\n"
        self.assertEqual(code_lines(text), [4, 7])

    def test_attributes_are_code(self):
        self.assertEqual(code_lines("#![warn(missing_docs)]\n#[derive(Debug)]\nstruct A;\n"), [1, 2, 3])

    def test_what_looks_like_a_comment_in_a_literal_is_code(self):
        text = """const A: &str = r#"
// "one

/* two
"#;
const B: &str = "\\"
// three";
const C: char = '"';
const D: [char; 3] = ['{', '\\'', '\\u{22}'];
fn e<'a>(f: &'a str) -> &'a str { "// four" }
"""
        self.assertEqual(code_lines(text), [1, 2, 4, 5, 6, 7, 8, 9, 10])
        self.assertEqual(source(text).beside, 0)

    def test_items_for_tests_are_no_code_and_what_follows_is(self):
        text = """#[cfg(test)]
use std::{fs, io};
fn a() {}
/// It is for tests.
#[cfg(test)]
#[allow(dead_code)]
pub(crate) const fn b(c: [u8; 3]) -> [u8; 3] {
    // }
    if '{' == '}' { c } else { "}" }
}
#[cfg(test)]
const D: E = E { f: 1 };
#[cfg(test)]
mod tests {
    #[cfg(test)]
    mod inner {}
    // why
}
/// `#[cfg(test)]` stands in this comment.
#[cfg(not(test))]
fn g() {}
"""
        self.assertEqual(code_lines(text), [3, 20, 21])
        self.assertEqual(source(text).beside, 0)
        self.assertEqual(lines(text, "unnamed-docs"), [])

    def test_brackets_that_do_not_match_are_told(self):
        with self.assertRaisesRegex(ValueError, "not closed"):
            source("fn a() {")
        with self.assertRaisesRegex(ValueError, "not opened"):
            source("}")


class Places(unittest.TestCase):
    def test_public_items(self):
        text = """pub fn a() {}
pub const unsafe extern "C" fn b() {}
pub const C: u8 = 1;
pub(crate) fn d() {}
pub struct E {
    pub f: u8,
}
pub use g::{h, i};
// pub fn j() {}
impl E { pub async fn k() {} }
const L: &str = "pub fn m";
"""
        self.assertEqual(lines(text, "pub-items"), [1, 2, 3, 5, 8, 10])

    def test_a_function_of_61_lines_of_code_is_long(self):
        body = "    one();\n\n    // why\n"
        # Its first and last lines count.
        long = "fn a(\n    b: [u8; 2],\n) {\n" + 57 * body + "}\n"
        self.assertEqual(lines(long.replace(body, "", 1), "long-functions"), [])
        self.assertEqual(lines("\n" + long, "long-functions"), [2])
        self.assertEqual(lines("impl A {\nfn c();\n" + long + "}", "long-functions"), [3])

    def test_closures_as_functions(self):
        text = """let a = |b| b;
    let mut c = move || d;
let e: &dyn Fn([u8; 2]) -> u8 =
    &|f| f[0];
let g = h | i;
let j = k.map(|l| l);
let m = "let n = |o| o";
"""
        self.assertEqual(lines(text, "closures"), [1, 2, 3])

    def test_tuples_unpacked_side_by_side(self):
        text = """let (a, mut b) = (1, 2);
let (c, _): ([u8; 2], u8) =
    ([1, 2], 3);
let (d, e) = (f + g).split();
let (Some(h), i) = (j, k);
let (l, m) = n();
let (o, Ok(p)) = (q, r) else { return };
"""
        self.assertEqual(lines(text, "tuple-lets"), [1, 2])

    def test_arrays_unpacked_from_a_map(self):
        text = """let [a, b] = [1, 2].map(c);
let [d, e]: [u8; 2] = [[1], [2]]
    .map(|f| { f[0]; });
let [g, h] = [1, 2];
let [i, j] = k.map(l);
let [m, n] = (o).map(p);
"""
        self.assertEqual(lines(text, "array-maps"), [1, 2])

    def test_packed_parameters_each(self):
        text = """fn a((b, c): (u8, u8), d: [u8; 3], [e, f]: [u8; 2]) {}
fn g<T: Fn((u8, u8)) -> u8, const N: usize>(
    h: Vec<(u8, u8)>,
    (i, j): (T, T),
) {
    let k = |(l, m): (u8, u8)| l;
}
fn n(o: (u8, u8), p: fn((u8, u8)) -> u8, Q(r): Q) {}
"""
        self.assertEqual(lines(text, "packed-parameters"), [1, 1, 4])

    def test_first_sentences_that_do_not_name_their_thing(self):
        text = """//! What this is.
//! It goes on.
/// Its number.
fn a() {}
/// Number of it.
///
/// Those go on.
struct B {
    ///
    /// The same again.
    c: u8,
    /// Iterations.
    d: u8, // Its comment.
    //// That is no doc comment.
    /// The ones that are named.
    e: u8,
}
/** Whether it is so. */
const F: &str = "
/// Of a literal.
";
/// Whether one is so.
/// Such goes on.

/// These begin.
fn g() {}
"""
        self.assertEqual(lines(text, "unnamed-docs"), [1, 3, 10, 18, 25])
        for word in ("What", "Where", "Who", "Its", "It", "Those", "That", "These", "Such", "Of"):
            self.assertEqual(lines(f"/// {word} is.\n\n/// {word}x.\n\n/// A {word}.", "unnamed-docs"), [1])
        for words in ("Whether it", "The same", "The one", "The other", "The rest"):
            self.assertEqual(lines(f"/// {words} is.\n\n/// {words.split()[0]} a.\n\n/// {words}x.", "unnamed-docs"), [1])

    def test_comments_beside_statements(self):
        text = "//! Doc.\n/// Doc.\nfn a() {\n    // why\n    // so\n    b(); // too\n    /* one\n    two */\n}\n//// so\n"
        self.assertEqual(source(text).beside, 6)

    def test_names_of_types(self):
        files = [
            source("struct A;\npub(crate) enum B {}\nimpl A { type C = A; }\n"),
            source('// struct A\nmod c { pub struct A<T>(T); }\nconst D: &str = "\nenum B";\n    pub trait C {}\n'),
            source("pub unsafe trait C {}\npub union E { f: u8 }\n"),
        ]
        shared = {name: [line for _, line in some] for name, some in count_lines.shared_types(files).items()}
        self.assertEqual(shared, {"A": [1, 2], "C": [5, 1]})


class Repository(unittest.TestCase):
    """A small one, with a crate of others."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = Path(folder.name)
        self.write("Cargo.toml", WORKSPACE)
        self.write("theirs/Cargo.toml", '[package]\nname = "theirs"\n')
        self.write("crates/sweepd-client/Cargo.toml", '[package]\nname = "sweepd-client"\n')
        for crate in ("theirs", "crates/sweepd-client", "."):
            self.write(f"{crate}/src/lib.rs", "")
        self.write(".ci/budget.toml", "# Head.\n\n")
        # One test is enough for cargo, which takes longer than all the rest.
        self.cargo = mock.patch.object(count_lines, "crates_of_others", return_value={})
        self.cargo.start()
        self.addCleanup(mock.patch.stopall)

    def write(self, path, text):
        (self.root / path).parent.mkdir(parents=True, exist_ok=True)
        (self.root / path).write_text(text)

    def budget(self):
        return (self.root / ".ci/budget.toml").read_text()

    def set_budget(self, **figures):
        """Sets figures of sweepd, after all have been set to what is counted."""
        self.write(".ci/budget.toml", "# Head.\n\n")
        self.run_script("--lower")
        head, table, rest = self.budget().partition("[sweepd]\n")
        for name, value in figures.items():
            name = name.replace("_", "-")
            rest = re.sub(rf"^{name} = .*", f"{name} = {value}", rest, count=1, flags=re.M)
        self.write(".ci/budget.toml", head + table + rest)

    def run_script(self, *words):
        """What the script prints, and what it says as it fails."""
        printed, failed = io.StringIO(), ""
        with contextlib.redirect_stdout(printed):
            try:
                count_lines.main(words, self.root)
            except SystemExit as end:
                failed = str(end.code)
        return printed.getvalue(), failed

    def test_each_crate_and_all_are_counted_without_tests(self):
        self.write(
            "src/lib.rs", '#[cfg(test)]\nmod tests;\n#[cfg(any(test, fuzzing))]\npub mod fuzz;\nmod a;\npub struct B;\n'
        )
        self.write("src/tests.rs", "fn c() {}\n")
        self.write("src/fuzz/mod.rs", "mod tests;\n")
        self.write("src/i/mod.rs", "#[cfg(any(test, fuzzing))]\nmod j;\n")
        self.write("src/i/j.rs", "fn k() {}\n")
        self.write("src/fuzz/d.rs", "fn e() {}\n")
        self.write("src/a.rs", "#[cfg(test)]\nmod f;\nmod tests;\n// why\n")
        self.write("src/a/f.rs", "fn g() {}\n")
        self.write("src/a/tests.rs", "pub struct B;\n")
        self.write("build.rs", "fn main() {}\n")
        self.write("tests/it.rs", "fn h() {}\n")
        self.write("crates/sweepd-testkit/Cargo.toml", '[package]\nname = "sweepd-testkit"\n')
        self.write("crates/sweepd-testkit/src/lib.rs", "pub struct B;\n")
        self.write("crates/sweepd-client/src/lib.rs", "struct B;\nstruct B;\n")
        subprocess.run(["cargo", "generate-lockfile", "--quiet", "--offline"], cwd=self.root, check=True)
        self.cargo.stop()
        own = {
            "code-lines": 5,
            "pub-items": 2,
            "shared-type-names": 1,
            "comments-per-100-lines": 20.0,
            "crates-of-others": 1,
        }
        client = {"code-lines": 2, "shared-type-names": 1, "crates-of-others": 0}
        # 100 / 7 = 14.28
        whole = {"code-lines": 7, "pub-items": 2, "shared-type-names": 1, "comments-per-100-lines": 14.2}
        wanted = {"all": NOTHING | whole, "sweepd": NOTHING | own, "sweepd-client": NOTHING | client}
        self.assertEqual(count_lines.counted(self.root), wanted)

    def test_without_a_tree_of_crates_nothing_is_judged(self):
        self.cargo.stop()
        with mock.patch.dict(os.environ, PATH=str(self.root)):
            self.assertIn("cannot run cargo: [Errno 2] No such file", self.run_script("--check")[1])
            self.write("cargo", "#!/bin/sh\nexit 101\n")
            (self.root / "cargo").chmod(0o755)
            self.assertRegex(
                self.run_script("--check")[1], r"\A`cargo tree --quiet --locked .*` failed, as a build would; .*\Z"
            )

    def test_a_budget_that_is_met_says_nothing(self):
        self.write("src/lib.rs", 100 * "fn a() {}\n")
        self.set_budget()
        self.assertEqual(self.run_script("--check"), ("", ""))

    def test_above_a_budget_fails(self):
        self.write("src/lib.rs", 98 * "fn a() {}\n" + "let a = |b| b;\nlet a = |b| b;\n")
        self.set_budget(code_lines=99, closures=0)
        printed, failed = self.run_script("--check")
        self.assertEqual(printed, "")
        lines, closures = failed.split("\n")
        change = ', or change the budget in a commit of its own, "budget: ...", that says why'
        self.assertEqual(lines, "sweepd: code-lines 100, budget 99: 1 too many; take them back" + change)
        self.assertEqual(
            closures, "sweepd: closures 2, budget 0: 2 too many; take them back (`count_lines.py --list closures`)" + change
        )

    def test_up_to_2_percent_below_a_budget_is_told_and_more_fails(self):
        self.write("src/lib.rs", 98 * "fn a() {}\n")
        self.set_budget(code_lines=100)
        self.assertEqual(self.run_script("--check"), ("sweepd: code-lines 98, budget 100: could be lowered by 2\n", ""))
        self.set_budget(code_lines=101)
        printed, failed = self.run_script("--check")
        self.assertEqual(printed, "")
        lower = "more than 2 %; `count_lines.py --lower` does it"
        self.assertEqual(failed, f"sweepd: code-lines 98, budget 101: could be lowered by 3, {lower}")

    def test_one_less_of_a_small_budget_fails(self):
        self.write("src/lib.rs", "let a = |b| b;\n")
        self.set_budget(closures=2)
        self.assertIn("sweepd: closures 1, budget 2: could be lowered by 1, more", self.run_script("--check")[1])

    def test_comments_are_at_least_so_many(self):
        self.write("src/lib.rs", 97 * "fn a() {}\n" + "fn a() {} // why\n" + 2 * "fn a() {}\n")
        self.set_budget(comments_per_100_lines=1.1)
        _, failed = self.run_script("--check")
        self.assertIn("sweepd: comments-per-100-lines 1.0, budget 1.1: 0.1 too few; say why beside statements, or", failed)
        self.set_budget(comments_per_100_lines=0.9)
        _, failed = self.run_script("--check")
        self.assertIn("sweepd: comments-per-100-lines 1.0, budget 0.9: could be raised by 0.1, more than 2 %", failed)

    def test_lower_lowers_and_raises_none(self):
        self.write("src/lib.rs", "// why\nlet a = |b| b;\n")
        self.set_budget()
        met = self.budget()
        self.set_budget(code_lines=0, closures=9, comments_per_100_lines=50)
        printed, failed = self.run_script("--lower")
        self.assertEqual(printed, "")
        self.assertRegex(failed, r"\Asweepd: code-lines 1, budget 0: 1 too many.*\Z")
        self.assertEqual(
            self.budget().split("[sweepd]"),
            met.replace("[sweepd]\ncode-lines = 1", "[sweepd]\ncode-lines = 0").split("[sweepd]"),
        )

    def test_a_crate_or_figure_that_is_new_or_gone(self):
        self.set_budget()
        met = self.budget()
        self.write(".ci/budget.toml", met.replace("[sweepd-client]", "[sweepd-clients]"))
        _, failed = self.run_script("--check")
        self.assertIn("sweepd-client: closures has no budget; `count_lines.py --lower` writes it\n", failed)
        self.assertIn(
            "sweepd-clients: closures has a budget and is not counted; `count_lines.py --lower` removes it\n", failed
        )
        self.assertEqual(self.run_script("--lower"), ("", ""))
        self.assertEqual(self.budget(), met)
        self.assertTrue(met.startswith("# Head.\n\n[all]\ncode-lines = 0\n"))

    def test_a_budget_that_cannot_be_read_is_one_error(self):
        for text, wrong in (
            ("[all]\ncode-lines =\n", "Invalid value (at line 2"),
            ('[all]\ncode-lines = "1"\n', "all code-lines is '1', no count"),
            ("[all]\ncode-lines = 1.5\n", "all code-lines is 1.5, no count"),
            ("[all]\ncode-lines = true\n", "all code-lines is True, no count"),
            ("[all]\ncomments-per-100-lines = nan\n", "all comments-per-100-lines is nan, no count"),
            ("all = 3\n", "all is no table"),
        ):
            self.write(".ci/budget.toml", text)
            printed, failed = self.run_script("--check")
            self.assertEqual(printed, "")
            self.assertRegex(
                failed, rf"\A{self.root}/\.ci/budget\.toml: .*; correct it, or take the file from the last commit\Z"
            )
            self.assertIn(wrong, failed)

    def test_sources_that_cannot_be_read_are_named(self):
        self.write("src/lib.rs", "fn a() {\n")
        self.assertEqual(
            self.run_script("--check")[1],
            f"{self.root}/src/lib.rs: a bracket is not closed; `cargo fmt --check` says where",
        )

    def test_places_are_listed(self):
        self.write("src/lib.rs", "struct A;\n    pub fn b() {}\n")
        self.write("crates/sweepd-client/src/lib.rs", "\npub struct A;\n")
        self.assertEqual(
            self.run_script("--list", "pub-items")[0],
            "src/lib.rs:2: pub fn b() {}\ncrates/sweepd-client/src/lib.rs:2: pub struct A;\n",
        )
        self.assertEqual(
            self.run_script("--list", "shared-type-names")[0],
            "src/lib.rs:1: struct A;\ncrates/sweepd-client/src/lib.rs:2: pub struct A;\n",
        )


if __name__ == "__main__":
    unittest.main()
