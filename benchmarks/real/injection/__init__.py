"""Known effects in real recordings. What grades the concealed proof grades these too, from its own folder."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "concealed"))
