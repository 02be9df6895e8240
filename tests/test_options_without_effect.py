"""Options that would change nothing, and values that cannot be meant, are refused in one line before anything is written."""

from pathlib import Path

import pytest

from idfslam.cli import command_line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("render {run} --seconds 5", "--seconds, --fps and --overwrite belong to a video: give --video along or --video orbit as well"),
        ("render {run} --fps 10", "belong to a video"),
        ("export {run} --to tum --images 5", "--images with --to tum: none of these has images; choose nerfstudio, colmap, points"),
        ("export {run} --to page --recording nowhere", "nowhere: no such file or folder, expected the run's recording"),
        ("report {run} --recording nowhere", "nowhere: no such file or folder, expected the run's recording"),
        ("reproduce --small --methods", "--methods: expected some of fast, paper, imap, nice behind it"),
        ("reproduce --small --data {run}", "with --small, which takes generated rooms alone: leave one of the two out"),
        ("reproduce --small --gpus 1", "--gpus 1: they are those of a cluster, give --cluster as well"),
        ("reproduce --small --gpus -1", "--gpus -1, expected a number of at least 0"),
        ("bench synthetic:0 --against", "--against: expected some of open3d, orbslam3, rtabmap, fusion behind it"),
        ("bench synthetic:0 --against fusion --no-mesh", "--against fusion with --no-mesh: only its surface is its own"),
        ("calibrate {run} --out camera.txt", "--out camera.txt: expected the name of a file that ends with .json"),
        ("calibrate {run} --out {run}/config.yaml/camera.json", "config.yaml is a file, expected a folder: choose another name"),
        ("run synthetic:0 --checkpoint-every -1", "--checkpoint-every -1, expected at least 0, which saves none"),
        ("calibrate", "no recordings, expected at least one, or a result folder of `run`"),
        ("calibrate {run} nowhere", "nowhere: no such file or folder, expected a recording"),
        ("calibrate opencv:0:2", "opencv:0:2: a live camera, expected a recording: record it first"),
        ("run synthetic:0 --camera.guess", "has its own camera and depth: leave the camera's values out"),
    ],
)
def test_an_option_without_effect_is_told(
    arguments: str, message: str, known_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        command_line.main(arguments.format(run=known_run).split())
    error = capsys.readouterr().err.splitlines()
    assert caught.value.code == 1 and message in error[-1] and [line for line in error if line.startswith("error: ")] == error[-1:]
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
