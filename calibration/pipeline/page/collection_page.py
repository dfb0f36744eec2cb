"""Page of a simulated dataset: the verdict, the numbers, all its images."""

from base64 import b64encode
from pathlib import Path

from calibration.ci.pages.html import Html, element, join
from calibration.ci.pages.page import bullets, figure, page, verdict_line
from calibration.ci.pages.tables import table
from calibration.ci.report import Report, Table

_SHEET = "Every pose that was collected: what each sensor saw, with its labels; red where a pose was lost."


def collection_page(report: Report, contact_sheet: Path | None) -> str:
    """Return the page, a single file.

    Args:
        report: of the collection.
        contact_sheet: the PNG, if there is one.
    """
    tables = [table(block.columns, block.rows) for block in report.blocks if isinstance(block, Table)]
    head = join(
        [
            element("h1", "Collected in simulation"),
            verdict_line(report.verdict, report.sentence),
            bullets((*report.reasons, *report.warnings)),
            *tables,
        ]
    )
    if contact_sheet is None:
        return page(f"Collected: {report.verdict}", [head])
    address = f"data:image/png;base64,{b64encode(contact_sheet.read_bytes()).decode('ascii')}"
    sheet = figure(Html(element("img", src=address, alt="Contact sheet of all poses")), _SHEET)
    return page(f"Collected: {report.verdict}", [head, sheet])
