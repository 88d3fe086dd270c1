"""The safety card as an HTML page beside the exported files."""

import shlex
import sys
from pathlib import Path

from torchpi.control.direct_inverse import DirectInverse
from torchpi.errors import ArtifactError
from torchpi.export.deployable import Deployable
from torchpi.export.formats import Files, written
from torchpi.export.safety_card import Load, safety_card
from torchpi.operators.reference_filter import ReferenceFilter


def page_files(
    compensator: Deployable,
    output: Path,
    reference_filter: ReferenceFilter | None = None,
    load: Load | None = None,
) -> Files:
    """Return NAME.html, the page of the safety card.

    Raises:
        ArtifactError: The compensator is not a direct inverse.
    """
    # Drawing libraries are slow to import, and only the page needs them.
    from torchpi.report.safety_page import safety_page
    from torchpi.report.what_was_run import provenance

    if not isinstance(compensator, DirectInverse):
        raise ArtifactError(
            f"{type(compensator).__name__} has no page: only a direct inverse has a safety card; "
            "leave page out of --to for this model"
        )
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    html = safety_page(output.name, safety_card(compensator, load), provenance(command, {}))
    return {output.with_name(output.name + ".html"): written(html)}
