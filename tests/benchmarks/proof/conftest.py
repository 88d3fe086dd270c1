"""The proof is a package of its own, beside torchpi."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks" / "proof"))
