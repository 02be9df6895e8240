"""Options that would change nothing are refused in one line."""

from pathlib import Path

import pytest

from idfslam.cli import command_line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("render {run} --seconds 5", "--seconds, --fps and --overwrite belong to a video: give --video along or --video orbit as well"),
        ("render {run} --fps 10", "belong to a video"),
        ("export {run} --to tum --images 5", "--images with --to tum: none of these has images; choose nerfstudio, colmap, points"),
    ],
)
def test_an_option_without_effect_is_told(arguments: str, message: str, known_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command_line.main(arguments.format(run=known_run).split())
    error = capsys.readouterr().err
    assert caught.value.code == 1 and message in error and error.count("\n") == 1
