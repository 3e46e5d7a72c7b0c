"""Made-up pictures of the samples that are drawn on a site of `page_site`."""

from typing import Any

from tests.server.pages.invented_board import LONG_AGO, MANIFEST
from tests.server.pages.page_site import real_drawings
from tests.support.made_pictures import png

from exceptiondrive_records.splits.tables import SamplePictureRow
from exceptiondrive_worker.splits.small_jpeg import small_jpeg

LICENCE = "CC <b>0</b> & kin"


def scene_ids() -> list[str]:
    return [e.drawing.sample_id for e in real_drawings(1).samples if e.chosen_as == "scene"]


def keep_pictures(site: Any, sample_ids: list[str]) -> bytes:
    """Show the same two pictures of each sample; return the bytes of the first."""
    shots = {"source": small_jpeg(png(64, 40), 1280), "edited": small_jpeg(png(60, 30), 1280)}
    files = site.app.state.services.files
    rows = []
    for sample_id in sample_ids:
        for shows, (jpeg, width_px, height_px) in shots.items():
            digest, _ = files.put_stream([jpeg], limit_bytes=2**20)
            rows.append(
                SamplePictureRow(
                    split_name="sample",
                    split_revision=MANIFEST.revision,
                    public_file_digest="sha256:" + "5" * 64,
                    sample_id=sample_id,
                    shows=shows,
                    file_digest=digest,
                    width_px=width_px,
                    height_px=height_px,
                    licence=LICENCE,
                    created_at=LONG_AGO,
                )
            )
    with site.database.write() as session:
        session.add_all(rows)  # the drawings are of samples that the small manifest does not name
    return shots["source"][0]
