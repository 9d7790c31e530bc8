"""Builds the site with all warnings as errors, checks its links, and prints its size.

``python3 -m uv run --group docs python docs/build.py``. Links to other sites need a network and are checked by
``sphinx-build -b linkcheck``; here they have to be whole addresses.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parents[1]
SITE = ROOT / "results" / "site"
sys.path.insert(0, str(ROOT / "tests"))  # for what is typed of the pages

from helpers.typed import blocks  # noqa: E402


class Page(HTMLParser):
    """The links, anchors and pictures of a page of the site."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.pictures: set[str] = set()
        self.feed(file.read_text())

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {name: value for name, value in attributes if value}
        self.anchors |= {found[name] for name in ("id", "name") if name in found}
        if tag == "a" and "href" in found:
            self.links.add(found["href"])
        if tag == "img" and "src" in found:
            self.links.add(found["src"])
            self.pictures.add(Path(urlsplit(found["src"]).path).name)


def wrong_links(pages: dict[Path, Page]) -> list[str]:
    """Links that lead to no file or anchor of the site, and addresses of other sites that are not whole."""
    wrong = []
    for file, page in pages.items():
        for link in page.links:
            address = urlsplit(link)
            if address.scheme:
                right = address.scheme == "mailto" or (address.scheme == "https" and "." in address.netloc)
            else:
                target = (file.parent / unquote(address.path)).resolve() if address.path else file
                right = target.exists()
                if right and address.fragment and target in pages:
                    right = unquote(address.fragment) in pages[target].anchors
            if not right:
                wrong.append(f"{file.relative_to(SITE)}: {link}")
    return sorted(wrong)


def main() -> None:
    begin = time.monotonic()
    build = ["-m", "sphinx", "-E", "-a", "-W", "-q", str(ROOT / "docs"), str(SITE)]
    if subprocess.run([sys.executable, *build], cwd=ROOT).returncode:
        sys.exit("the site has warnings, which are errors")
    seconds = time.monotonic() - begin
    pages = {file: Page(file) for file in SITE.glob("**/*.html") if "_static" not in file.parts}
    if wrong := wrong_links(pages):
        sys.exit("\n".join(["links that lead nowhere:", *wrong]))
    sources = [ROOT / "README.md", *(ROOT / "docs").glob("**/*.md")]
    with_tests = [page for page in sources if page.name not in ("api.md", "gallery.md")]
    typed = [text for page in with_tests for _, text in blocks(page) if text.strip()]
    jobs = sum(len(re.findall(r"^ *```yaml", page.read_text(), re.MULTILINE)) for page in sources)
    pictures = {name for page in pages.values() for name in page.pictures}
    elsewhere = {link for page in pages.values() for link in page.links if urlsplit(link).scheme}
    print(f"built in {seconds:.0f} s: {len(pages)} pages, {len(pictures)} pictures")
    print(f"{len(typed)} blocks of shell and Python that tests type, {jobs} parts of jobs that tests check")
    print(f"{sum(len(page.links) for page in pages.values())} links, of them {len(elsewhere)} to other sites")


if __name__ == "__main__":
    main()
