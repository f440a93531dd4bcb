#!/usr/bin/env python3
"""Counts what our Rust consists of, and holds it to .ci/budget.toml. Tests and the test kit do not count.

    count_lines.py                   lines of code of rooms, of the whole, and of what each package of a release is made of
    count_lines.py --list closures   where these are; the same for each figure of the budget that has places
    count_lines.py --check           fails where a figure is above its budget, or more than 2 % below it
    count_lines.py --lower           lowers the budgets to the figures, raises none, and checks

Needs Python 3.11 and cargo.
"""

import argparse
import json
import re
import signal
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUDGET = ".ci/budget.toml"
# Programs and the library of which the crates of others are counted.
BUILDS = ("sweepd", "sweepd-client", "sweepd-ros2")
# One for all machines, because some crates are for one kind of them.
TARGET = "x86_64-unknown-linux-gnu"
# Figures that have places.
LISTED = (
    "pub-items",
    "long-functions",
    "closures",
    "tuple-lets",
    "array-maps",
    "packed-parameters",
    "unnamed-docs",
    "shared-type-names",
)
# Tests alone, and the soak, have it.
TESTKIT = "sweepd-testkit"
LONG = 60
AT_LEAST = "comments-per-100-lines"
SLACK = 0.02
CURE = "correct it, or take the file from the last commit"

TOKEN = re.compile(
    r"""//[^\n]*
    |/\*
    |(?<!\w)[bc]?r(?P<hashes>\#*)".*?"(?P=hashes)
    |"(?:[^"\\]|\\.)*"
    |'(?:\\(?:u\{[^}']*\}|x..|.)|[^'\\\n])'""",
    re.S | re.X,
)
# With the documentation above.
TEST = re.compile(r"""(?:^[ ]*///[^\n]*\n)*[ ]*(?P<attribute>#\[cfg\((?:test|any\(test, fuzzing\))\)\])""", re.M)
ITEM = re.compile(
    r"""(?:\s*\#\[[^\]]*\])*\s*(?:pub(?:\([^)]*\))?\s+)?(?:(?:const|unsafe|async|extern)\s+(?:"+\s+)?)*
    (?:(?P<kind>fn|use|impl|struct|enum|union|const|static|trait|type)\b|mod\s+(?P<module>\w+))""",
    re.X,
)
ENDED_BY_SEMICOLON = ("use", "const", "static", "type")
PUB = re.compile(
    r"""\bpub\s+(?:(?:const|unsafe|async|extern)\s+(?:"+\s+)?)*
    (?:fn|use|struct|enum|union|const|static|trait|type|mod|macro)\b""",
    re.X,
)
FUNCTION = re.compile(r"\bfn\s+\$?\w+")
TYPE = re.compile(r"(?:\b(?:struct|enum|trait)|^[ ]*(?:pub(?:\([^)]*\))?\s+)?union)\s+(\w+)", re.M)
CLOSURE = re.compile(
    r"^[ ]*let\s+(?:mut\s+)?\w+(?:\s*:(?:[^=;\[]|\[[^\]]*\])*)?\s*=\s*(?:&\s*(?:mut\s+)?)?(?:move\s*)?\|", re.M
)
TUPLE_LET = re.compile(r"^[ ]*let\s+(?=\((?:mut\s+)?\w+,)", re.M)
ARRAY_LET = re.compile(r"^[ ]*let\s+(?=\[)", re.M)
ASSIGNED = re.compile(r"(?:\s*:(?:[^=;\[]|\[[^\]]*\])*)?\s*=\s*(?=[(\[])")
UNNAMED = re.compile(r"(?:What|Where|Who|Whether it|Its|It|The same|Those|That|These|Such|Of|The one|The other|The rest)\b")


def filled(text, mark):
    """The text with this mark for each visible character."""
    return re.sub(r"\S", mark, text)


def comment_end(text, begin):
    """The end of the block comment that begins there. Others may stand in it."""
    depth = 0
    for mark in re.compile(r"/\*|\*/").finditer(text, begin):
        depth += 1 if mark[0] == "/*" else -1
        if depth == 0:
            return mark.end()
    return len(text)


def split(text):
    """The text with blanks for comments and quotation marks for literals, and where the comments are."""
    parts, comments, at = [], [], 0
    while token := TOKEN.search(text, at):
        begin, end = token.span()
        comment = token[0].startswith(("//", "/*"))
        if token[0] == "/*":
            end = comment_end(text, begin)
        if comment:
            comments.append((begin, end))
        parts += [text[at:begin], filled(text[begin:end], " " if comment else '"')]
        at = end
    return "".join([*parts, text[at:]]), comments


def brackets(code):
    """The place of the closing bracket for that of each opening one."""
    closing, opened = {}, []
    for bracket in re.finditer(r"[][(){}]", code):
        if bracket[0] in "([{":
            opened.append(bracket.start())
        elif opened:
            closing[opened.pop()] = bracket.start()
        else:
            raise ValueError("a bracket is closed that was not opened")
    if opened:
        raise ValueError("a bracket is not closed")
    return closing


def item_end(code, at, closing, braces=True):
    """The end of an item, from a place behind its name: a semicolon, or the end of its first braces if they end it."""
    while mark := re.compile(r"[;({\[]").search(code, at):
        if mark[0] == ";":
            return mark.end()
        at = closing[mark.start()] + 1
        if mark[0] == "{" and braces:
            return at
    return len(code)


def without_tests(text, code):
    """The code with blanks for items that are tests, where these are, and the names of modules in files of their own."""
    closing, tests, modules = brackets(code), [], []
    for attribute in TEST.finditer(text):
        item = ITEM.match(code, attribute.end())
        if code[attribute.start("attribute")] != "#" or not item:
            continue
        begin, end = attribute.start(), item_end(code, item.end(), closing, item["kind"] not in ENDED_BY_SEMICOLON)
        if item["module"] and code[end - 1] == ";":
            modules.append(item["module"])
        tests.append((begin, end))
        code = code[:begin] + filled(code[begin:end], " ") + code[end:]
    return code, tests, modules


def parameters(code, at):
    """The place of the bracket before the parameters of a function whose name ends at `at`; `None` if there is none."""
    depth = 0
    for mark in re.compile(r"[-=]>|[<>(]|[^\s]").finditer(code, at):
        if mark[0] in "<>":
            depth += 1 if mark[0] == "<" else -1
        elif mark[0] == "(" and depth == 0:
            return mark.start()
        elif depth == 0:
            return None
    return None


def packed(code, begin, closing):
    """The places of parameters that are tuples or arrays of names, among those from this bracket on."""
    at = begin + 1
    while bracket := re.compile(r"[(\[]").search(code, at, closing[begin]):
        at = closing[bracket.start()] + 1
        if code[begin : bracket.start()].rstrip()[-1] in "(," and re.compile(r"\s*:(?!:)").match(code, at):
            yield bracket.start()


def unpacked(code, closing, pattern, ending):
    """The places of `let` with brackets on both sides, where `ending` follows."""
    for let in pattern.finditer(code):
        assigned = ASSIGNED.match(code, closing[let.end()] + 1)
        if assigned and code[assigned.end()] == code[let.end()] and ending.match(code, closing[assigned.end()] + 1):
            yield let.start()


class Source:
    """What one source consists of."""

    def __init__(self, path, text):
        self.path, self.text = path, text
        self.code, self.comments = split(text)
        self.code, self.tests, self.modules = without_tests(text, self.code)
        self.is_code = [bool(line.strip()) for line in self.code.split("\n")]
        # Lines, for each figure with places.
        self.places = defaultdict(list)
        # Names and lines.
        self.types = [(name[1], self.line(name.start(1))) for name in TYPE.finditer(self.code)]
        self.beside = 0
        self.read_code()
        self.read_comments()

    def line(self, at):
        return self.text.count("\n", 0, at) + 1

    def add(self, figure, *places):
        self.places[figure] += [self.line(at) for at in places]

    def read_code(self):
        code, closing = self.code, brackets(self.code)
        self.add("pub-items", *(item.start() for item in PUB.finditer(code)))
        self.add("closures", *(let.start() for let in CLOSURE.finditer(code)))
        self.add("tuple-lets", *unpacked(code, closing, TUPLE_LET, re.compile(r"\s*;")))
        self.add("array-maps", *unpacked(code, closing, ARRAY_LET, re.compile(r"\s*\.map\(")))
        for function in FUNCTION.finditer(code):
            begin = parameters(code, function.end())
            if begin is None:
                continue
            self.add("packed-parameters", *packed(code, begin, closing))
            end = item_end(code, closing[begin] + 1, closing)
            if sum(self.is_code[self.line(function.start()) - 1 : self.line(end)]) > LONG:
                self.add("long-functions", function.start())

    def read_comments(self):
        """Counts the comments beside statements, and looks at the first sentences of the others."""
        above = None
        for begin, end in self.comments:
            if any(test[0] <= begin < test[1] for test in self.tests):
                continue
            mark = re.match(r"//[/!](?!/)|/\*[*!](?![*/])", self.text[begin:end])
            line = self.line(begin)
            if not mark:
                self.beside += self.line(end) - line + 1
                continue
            sentence = self.text[begin + 3 : end].lstrip(" *\n")
            # A line that goes on from the one above begins no sentence, unless all above are empty.
            goes_on = above == (line - 1, mark[0])
            if not goes_on and UNNAMED.match(sentence):
                self.places["unnamed-docs"].append(line)
            above = (line, mark[0]) if sentence or goes_on else None


def read_toml(path):
    try:
        return tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        sys.exit(f"{path}: {error}; {CURE}")


def crates(root):
    """The folders of our crates, by name, but for the test kit."""
    manifests = [root / "Cargo.toml", *sorted(root.glob("crates/*/Cargo.toml"))]
    folders = {read_toml(one)["package"]["name"]: one.parent for one in manifests}
    return {name: folder for name, folder in folders.items() if name != TESTKIT}


def sources(folder, root):
    """The sources of a crate, without those that are tests."""
    files, tests = [], set()
    for path in sorted([*folder.glob("build.rs"), *folder.glob("src/**/*.rs")]):
        try:
            file = Source(path.relative_to(root), path.read_text())
        except ValueError as error:
            sys.exit(f"{path}: {error}; `cargo fmt --check` says where")
        files.append(file)
        inner = path.parent if path.stem in ("mod", "lib", "main") else path.with_suffix("")
        tests |= {(inner / module).relative_to(root) for module in file.modules}
    return [file for file in files if not tests & {file.path.with_suffix(""), *file.path.parents}]


def places(files, figure):
    """Where a figure has its places, as sources and lines."""
    if figure != "shared-type-names":
        return [(file, line) for file in files for line in file.places[figure]]
    return [place for _, some in sorted(shared_types(files).items()) for place in some]


def shared_types(files):
    """Where types of the same name are, by name."""
    named = defaultdict(list)
    for file in files:
        for name, line in file.types:
            named[name].append((file, line))
    return {name: some for name, some in named.items() if len(some) > 1}


def figures(files):
    """The figures of these files together."""
    lines = sum(sum(file.is_code) for file in files)
    counts = {"code-lines": lines} | {figure: len(places(files, figure)) for figure in LISTED}
    # A name counts once, in however many places it is.
    counts["shared-type-names"] = len(shared_types(files))
    # Rounded down: a tenth is reached, or not.
    counts[AT_LEAST] = 1000 * sum(file.beside for file in files) // max(lines, 1) / 10
    return counts


def crates_of_others(root, ours):
    """For each build, the number of crates that are not ours."""
    command = f"cargo tree --quiet --locked -e normal,build --prefix none --target {TARGET} -p".split()
    try:
        trees = {
            name: subprocess.Popen([*command, name], cwd=root, stdout=subprocess.PIPE, text=True)
            for name in BUILDS
            if name in ours
        }
    except OSError as error:
        sys.exit(f"cannot run cargo: {error}; the crates of others are counted with it")
    texts = {name: tree.communicate()[0] for name, tree in trees.items()}
    if any(tree.returncode for tree in trees.values()):
        sys.exit(f"`{' '.join(command)} ...` failed, as a build would; its message stands above")
    crates = {name: {tuple(line.split()[:2]) for line in text.splitlines() if line} for name, text in texts.items()}
    return {name: sum(one[0] not in ours for one in some) for name, some in crates.items()}


def counted(root):
    """The figures of each crate and of all together."""
    folders = crates(root)
    files = {name: sources(folder, root) for name, folder in folders.items()}
    result = {"all": figures([file for some in files.values() for file in some])}
    result |= {name: figures(some) for name, some in files.items()}
    for name, count in crates_of_others(root, folders).items():
        result[name]["crates-of-others"] = count
    return result


def read_budgets(path):
    budgets = read_toml(path)
    for crate, table in budgets.items():
        if not isinstance(table, dict):
            sys.exit(f"{path}: {crate} is no table; {CURE}")
        for figure, value in table.items():
            kinds = (int, float) if figure == AT_LEAST else (int,)
            if type(value) not in kinds or not 0 <= value < 1e9:
                sys.exit(f"{path}: {crate} {figure} is {value!r}, no count; {CURE}")
    return budgets


def rows(tables):
    return [(crate, figure, value) for crate, table in tables.items() for figure, value in table.items()]


def excess(figure, value, budget):
    """How far the figure is beyond its budget; less than 0 if the budget could be lowered."""
    return round(budget - value if figure == AT_LEAST else value - budget, 1)


def judged(counts, budgets):
    """What could be lowered, and what is wrong, in sentences."""
    lower, wrong = [], []
    for crate, figure, value in rows(counts):
        budget = budgets.get(crate, {}).get(figure)
        if budget is None:
            wrong.append(f"{crate}: {figure} has no budget; `count_lines.py --lower` writes it")
            continue
        beyond = excess(figure, value, budget)
        sentence = f"{crate}: {figure} {value}, budget {budget}: "
        if beyond > 0:
            cure = "few; say why beside statements" if figure == AT_LEAST else "many; take them back"
            where = f" (`count_lines.py --list {figure}`)" if figure in LISTED else ""
            other = 'or change the budget in a commit of its own, "budget: ...", that says why'
            wrong.append(f"{sentence}{beyond} too {cure}{where}, {other}")
        elif beyond < 0:
            sentence += f"could be {'raised' if figure == AT_LEAST else 'lowered'} by {-beyond}"
            if -beyond > SLACK * budget:
                wrong.append(f"{sentence}, more than 2 %; `count_lines.py --lower` does it")
            else:
                lower.append(sentence)
    for crate, figure, _ in rows(budgets):
        if figure not in counts.get(crate, {}):
            wrong.append(f"{crate}: {figure} has a budget and is not counted; `count_lines.py --lower` removes it")
    return lower, wrong


def lowered(counts, budgets):
    """The budgets, each at its figure unless that would raise it."""
    result = {crate: dict(table) for crate, table in counts.items()}
    for crate, figure, value in rows(counts):
        budget = budgets.get(crate, {}).get(figure, value)
        if excess(figure, value, budget) > 0:
            result[crate][figure] = budget
    return result


def check(root, lower):
    path = root / BUDGET
    budgets, counts = read_budgets(path), counted(root)
    if lower:
        budgets = lowered(counts, budgets)
        head = re.split(r"^\[", path.read_text(), maxsplit=1, flags=re.M)[0]
        tables = [
            f"[{crate}]\n" + "".join(f"{one} = {value}\n" for one, value in table.items())
            for crate, table in budgets.items()
        ]
        path.write_text(head + "\n".join(tables))
    possible, wrong = judged(counts, budgets)
    for sentence in possible:
        print(sentence)
    if wrong:
        sys.exit("\n".join(wrong))


def print_places(root, figure):
    files = [file for folder in crates(root).values() for file in sources(folder, root)]
    for file, line in places(files, figure):
        print(f"{file.path}:{line}: {file.text.splitlines()[line - 1].strip()}")


def room(path):
    parts = path.with_suffix("").parts
    return "/".join(parts[:2])


def shipped(root):
    """The packages of a release, and the crates of ours that each is built from."""
    command = ["cargo", "metadata", "--format-version", "1", "--no-deps"]
    members = json.loads(subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout)["packages"]
    uses = {one["name"]: {d["name"] for d in one["dependencies"] if d["kind"] != "dev"} for one in members}
    release = (root / ".ci/release").read_text()
    for package in re.search(r"^for package in (.*); do$", release, re.M)[1].split():
        built, more = set(), {package}
        while more:
            built |= more
            more = {name for crate in more for name in uses[crate] if name in uses} - built
        yield package, built


def print_lines(root):
    rooms, lines = Counter(), Counter()
    for crate, folder in crates(root).items():
        for file in sources(folder, root):
            rooms[room(file.path)] += sum(file.is_code)
            lines[crate] += sum(file.is_code)
    for name, count in rooms.most_common():
        print(f"{count:6} {name}")
    print(f"{rooms.total():6} all\n")
    for package, built in shipped(root):
        print(f"{sum(lines[crate] for crate in built):6} built for the package {package}")


def main(words, root=ROOT):
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    one = options.add_mutually_exclusive_group()
    one.add_argument("--list", choices=LISTED, help="where these are")
    one.add_argument("--check", action="store_true", help="holds the figures to .ci/budget.toml")
    one.add_argument("--lower", action="store_true", help="lowers the budgets to the figures")
    asked = options.parse_args(words)
    if asked.list:
        print_places(root, asked.list)
    elif asked.check or asked.lower:
        check(root, asked.lower)
    else:
        print_lines(root)


if __name__ == "__main__":
    # `--list closures | head` ends quietly.
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    main(sys.argv[1:])
