"""The docstring examples of the notebook interface run, one after another."""

import doctest
from pathlib import Path
from typing import Any

import pytest

import torchpi
from torchpi import Compensator, Recording
from torchpi.notebook.diagnosed import Diagnosed
from torchpi.notebook.tracked import Tracked

DOCUMENTED = (
    Recording.from_arrays,
    Compensator,
    Compensator.predict,
    Compensator.save,
    Compensator.track,
    Tracked,
    Compensator.export,
    torchpi.diagnose,
    Diagnosed,
)


@pytest.mark.long
def test_every_example_gives_what_it_states(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for documented in DOCUMENTED:
        title = documented.__qualname__
        (example,) = doctest.DocTestFinder(recurse=False).find(documented, title, globs=names)
        assert example.examples, f"{title} has no example"
        said: list[str] = []
        result = doctest.DocTestRunner().run(example, out=said.append, clear_globs=False)
        assert result.failed == 0, "".join(said)
        names = example.globs
    results = (names["compensator"], names["result"], names["found"])
    for html in [one._repr_html_() for one in results]:
        assert "<table>" in html and 'href="http' not in html and "<script" not in html
    assert "Compensator(10000 Hz" in repr(results[0]) and "µm rms" in repr(results[1])
    for what in ("linearity", "error", "voltage"):
        assert names["result"].plot(what)._repr_html_().startswith("<svg")
    names["result"].plot().savefig(tmp_path / "motion.png")
    assert (tmp_path / "motion.png").read_bytes().startswith(b"\x89PNG")
    for result in results[1:]:
        with pytest.raises(torchpi.TorchpiError, match="what: found 'loops', expected one of"):
            result.plot("loops")
    with pytest.raises(torchpi.TorchpiError, match=r"motion\.doc: found '.doc', expected one of"):
        names["result"].plot().savefig(tmp_path / "motion.doc")
