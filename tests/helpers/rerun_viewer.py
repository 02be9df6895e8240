"""A viewer that writes recording.rrd, where rerun is installed."""

import pytest

from idfslam.viewer.rerun_viewer import RerunViewer

NO_RERUN = "rerun is not installed: pip install 'idf-slam[viewer]'"


def viewer() -> RerunViewer:
    pytest.importorskip("rerun", reason=NO_RERUN)
    return RerunViewer("file")
