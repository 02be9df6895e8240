"""Held-out views of a run: measured, written to views.json, and a few of them drawn beside the recorded images."""

from rich.console import Console
from rich.progress import track

from idfslam.evaluation.view_error import ViewError, summary
from idfslam.pictures.image_files import RenderedView, draw_views
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.held_out_views import compared_views, held_out
from idfslam.storage import atomic_files

VIEWS, PICTURE = "views.json", "held_out_views.png"
_DRAWN = 6  # views in the picture. More: a longer picture


def compare_views(run: FinishedRun, *, of_map: bool = False, console: Console | None = None) -> list[ViewError]:
    """Compares the held-out frames with rendered views, and writes views.json and held_out_views.png into the run's folder.

    of_map: the map's own colour is rendered instead of the archive's images. console: where progress is shown. Raises ResultError if the
    run held no frame out, or if another's file is in the place of one that is written.
    """
    ledger = result_folder.ledger(run.folder)
    ledger.refuse_foreign([VIEWS, PICTURE])
    count = len(held_out(run))
    errors, drawn = list[ViewError](), list[RenderedView]()
    compared = compared_views(run, run.map if of_map else run.views)
    for n, view in enumerate(track(compared, "views", total=count, console=console, disable=console is None)):
        errors.append(view.error)
        if n * _DRAWN // count != (n - 1) * _DRAWN // count:
            drawn.append(RenderedView(view.frame.index, view.frame.colour, view.frame.depth, view.colour, view.depth))
    atomic_files.write_json(run.folder / VIEWS, summary(errors))
    with atomic_files.replacing(run.folder / PICTURE) as part:
        draw_views(part, drawn)
    ledger.record([VIEWS, PICTURE])
    return errors
