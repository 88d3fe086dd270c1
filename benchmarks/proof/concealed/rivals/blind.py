"""Two rivals that ignore the recordings: always the most frequent group, and a guess.

    python -m concealed.rivals.blind most_frequent a.csv … --output DIR
    python -m concealed.rivals.blind guess a.csv … --output DIR

Of the groups that u and y cannot tell apart, the static one has the most effects. The guess is one name from
the list, or none, drawn by a hash of the first recording's bytes.
"""

import argparse
import hashlib
from pathlib import Path

from concealed.names import NAMES, STATIC
from concealed.rivals.contract import named, write_diagnosis


def main() -> None:
    """Answer without examining the recordings."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=("most_frequent", "guess"))
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--output", type=Path, required=True)
    options = parser.parse_args()
    if options.kind == "most_frequent":
        first, *others = sorted(STATIC)
        effects = [named(first, 1, alternatives=others)]
    else:
        number = int(hashlib.sha256(options.files[0].read_bytes()).hexdigest(), 16)
        effects = [named(name, 1) for name in [[], *([n] for n in NAMES)][number % (len(NAMES) + 1)]]
    write_diagnosis(options.output, effects, [], {})


if __name__ == "__main__":
    main()
