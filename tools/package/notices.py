"""Prints the licences of all crates that the program and the Python module link.

Many licences require that binaries are distributed with the licence's text.

usage: notices.py [CARGO'S ARGUMENTS...]
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXTS = ("LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "NOTICE", "UNLICENSE")


def linked(arguments: list[str]) -> list[dict[str, str]]:
    """Returns all direct and indirect dependencies that come from a registry, sorted by name and version."""
    command = ["cargo", "metadata", "--format-version", "1", "--locked", *arguments]
    read = json.loads(subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout)
    packages = {package["id"]: package for package in read["packages"]}
    uses = {
        node["id"]: [d["pkg"] for d in node["deps"] if any(kind["kind"] is None for kind in d["dep_kinds"])]
        for node in read["resolve"]["nodes"]
    }
    found: set[str] = set()
    left = [package["id"] for package in read["packages"] if package["source"] is None]
    while left:
        package = left.pop()
        if package not in found:
            found.add(package)
            left.extend(uses[package])
    crates = (packages[package] for package in found)
    return sorted((crate for crate in crates if crate["source"]), key=lambda crate: (crate["name"], crate["version"]))


def texts(crate: dict[str, str]) -> list[str]:
    """Returns the texts of a crate's licence files, without duplicates."""
    folder = Path(crate["manifest_path"]).parent
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name.upper().startswith(TEXTS))
    return list(dict.fromkeys(path.read_text(errors="replace").strip() for path in files if path.suffix != ".rs"))


def main() -> None:
    sys.stdout.reconfigure(encoding="utf-8", newline="\n")  # type: ignore[union-attr]
    print("meniscus links the crates below. Each crate is under the licence that is printed with it.")
    seen: dict[str, str] = {}
    for crate in linked(sys.argv[1:]):
        name = f"{crate['name']} {crate['version']}"
        print(f"\n{'=' * 80}\n{name}: {crate['license']}, {crate['repository']}\n")
        for text in texts(crate) or ["The crate contains no licence text: see LICENSE-APACHE and LICENSE-MIT of meniscus."]:
            first = seen.setdefault(text, name)
            print(text if first == name else f"The same text as for {first}.")


if __name__ == "__main__":
    main()
