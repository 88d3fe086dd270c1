"""Compare peers: each fits one record and predicts others, and one streamed step is timed.

    python benchmarks/peers/compare.py [--write] [--only torchpi,jax]

`--write` renews docs/peers.md and docs/peers.png. Peers are optional: benchmarks/peers/requirements.txt lists
them, and one that is not installed is left out with a message. On one core this takes about four minutes.
"""

import os
import tempfile

# Set before numba, XLA and the others read them: one core, and no kernels compiled earlier.
os.environ.update(
    OMP_NUM_THREADS="1",
    NUMBA_CACHE_DIR=tempfile.mkdtemp(prefix="peers-"),
    XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
)

import argparse
import atexit
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import torch
import with_dynonet
import with_jax_sysid
import with_loops
import with_lstsq
import with_sysidentpy
import with_torchpi
from figure import error_against_time
from measure import compare
from page import page, table
from task import make_task

from torchpi.files import write_atomically
from torchpi.report.png import write_png

DOCS = Path(__file__).parents[2] / "docs"
PEERS = (
    with_torchpi.JOINT,
    with_torchpi.TWO_STAGE,
    with_lstsq.PEER,
    with_jax_sysid.LBFGS,
    with_jax_sysid.ADAM,
    with_loops.SCRIPTED,
    with_loops.EAGER,
    with_dynonet.PEER,
    with_sysidentpy.PEER,
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="renew docs/peers.md and docs/peers.png")
    parser.add_argument("--only", default="", help="peers whose name has one of these words")
    options = parser.parse_args()
    torch.set_num_threads(1)
    atexit.register(shutil.rmtree, os.environ["NUMBA_CACHE_DIR"], ignore_errors=True)
    words = options.only.lower().split(",")
    wanted = [peer for peer in PEERS if any(word in peer.name.lower() for word in words)]
    for peer in wanted:
        if find_spec(peer.package) is None:
            print(
                f"{peer.name}: left out, {peer.package} is not installed (benchmarks/peers/requirements.txt)"
            )
    rows = compare(make_task(), [peer for peer in wanted if find_spec(peer.package)])
    print(table(rows))
    if options.write:
        git = ["git", "rev-parse", "--short", "HEAD"]
        commit = subprocess.run(git, cwd=DOCS, capture_output=True, text=True, check=True).stdout.strip()
        with write_atomically(DOCS / "peers.md") as temporary:
            temporary.write_text(page(rows, commit), encoding="utf-8")
        write_png(error_against_time(rows), DOCS / "peers.png", dots_per_inch=200)


if __name__ == "__main__":
    main()
