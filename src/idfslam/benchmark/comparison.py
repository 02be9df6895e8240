"""Compares our runs of a recording with those of the peers: means, ratios to ours, and who is ahead in what."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from idfslam.benchmark.table import SURFACE, Column, MeanStd, markdown_table

OURS = "idf-slam"
RULES = (
    "Same frames, same evaluator, in turns on the same cores. The time of the others is that of their own calls, without the reading of "
    "images; ours is that of everything but mesh and report."
)
COLUMNS = (
    Column("ate_m", "ATE RMSE [cm]", 100),
    *SURFACE,
    Column("frames_per_second", "frames/s"),
    Column("peak_memory_mb", "peak memory [MiB]", digits=0),
    Column("lost_frames", "lost frames", digits=1),
)
_SURFACE = tuple(column.key for column in SURFACE)
_MORE_IS_BETTER = ("completion_ratio", "precision", "f1", "frames_per_second")
_JUDGED = tuple(column.key for column in COLUMNS if column.key != "lost_frames")
_LOST = 0.05  # [1] share of lost frames up to which a method can be ahead: errors are over tracked frames. Raised, one that tracks less can
#    win. Chosen by hand


def comparison(recording: Mapping[str, Any], missing: Mapping[str, str], borrowing: Collection[str] = ()) -> dict[str, Any]:
    """Rows of all methods, ours first, and the winner of each column.

    recording: has `runs` and `summary` of ours, and `peers` with the same for each peer. missing: how to install what is not there.
    borrowing: the peers that take our poses. They are judged by their surfaces alone.
    A row has the method, how many runs finished, the summary, the ratios of its means to ours, and a note where something is to be said.
    """
    ours = recording["summary"]
    rows = [_row(OURS, recording["runs"], ours, ours)]
    for name, peer in recording["peers"].items():
        row = _row(name, peer["runs"], peer["summary"], ours)
        rows.append(row | {"note": f"not run: {missing[name]}"} if name in missing else row)
    return {"rules": RULES, "columns": [asdict(column) for column in COLUMNS], "rows": rows, "winners": _winners(rows, borrowing)}


def _row(method: str, runs: Sequence[Mapping[str, Any]], summary: Mapping[str, Any], ours: Mapping[str, Any]) -> dict[str, Any]:
    finished = [run for run in runs if "failed" not in run]
    failed = [run["failed"] for run in runs if "failed" in run]
    means = {key: spread["mean"] for key, spread in summary.items()}
    ratios = {key: means[key] / ours[key]["mean"] for key in _JUDGED if key in means and ours.get(key, {}).get("mean")}
    share = means.get("lost_frames", 0.0) / finished[0]["frames"] if finished else 1.0
    notes = [f"{len(failed)} of {len(runs)} runs failed: {failed[0]}"] if failed else []
    notes += [f"lost {share:.0%} of the frames; its errors are over the others"] if finished and share > _LOST else []
    version = finished[0].get("version") if finished else None
    counts = {"finished": len(finished), "runs": len(runs), "lost_share": share, "version": version}
    return {"method": method, **counts, "summary": dict(summary), "ratios": ratios, "note": "; ".join(notes) or None}


def _winners(rows: Sequence[Mapping[str, Any]], borrowing: Collection[str]) -> dict[str, str]:
    """The best method of each column, among those that finished a run and tracked nearly all frames."""
    able = [row for row in rows if row["finished"] and row["lost_share"] <= _LOST]
    winners = {}
    for key in _JUDGED:
        having = [row for row in able if key in row["summary"] and (key in _SURFACE or row["method"] not in borrowing)]
        if len(having) > 1:
            sign = -1 if key in _MORE_IS_BETTER else 1
            winners[key] = min(having, key=lambda row: sign * row["summary"][key]["mean"])["method"]
    return winners


def comparison_markdown(results: Mapping[str, Any]) -> str:
    """A table for each recording, the best value of a column in bold, then what the peers are and the published figures."""
    parts = [f"Against other systems. {RULES}"]
    for recording in results["recordings"]:
        found = recording["comparison"]
        parts += [f"{recording['name']}:", _table(found), *(f"{row['method']}: {row['note']}" for row in found["rows"] if row["note"])]
        if recording["published"]:
            parts += ["Published for this sequence, by others, on other machines:", published_markdown(recording["published"])]
    parts += [f"{name}: {peer['about']}." for name, peer in results["peers"].items()]
    return "\n\n".join(parts)


def _table(found: Mapping[str, Any]) -> str:
    used = [c for c in COLUMNS if any(c.key in row["summary"] for row in found["rows"])]
    ratios = [c for c in used if c.key in ("ate_m", "frames_per_second")]
    titles = ["method", "runs", *(c.title for c in used), *(f"{c.title.split(' [')[0]} / ours" for c in ratios)]
    rows = [
        [
            row["method"],
            f"{row['finished']} of {row['runs']}",
            *(_cell(row, column, found["winners"]) for column in used),
            *(f"{row['ratios'][c.key]:.2f}" if c.key in row["ratios"] else "-" for c in ratios),
        ]
        for row in found["rows"]
    ]
    return markdown_table(titles, rows)


def _cell(row: Mapping[str, Any], column: Column, winners: Mapping[str, str]) -> str:
    if column.key not in row["summary"]:
        return "-"
    text = MeanStd(**row["summary"][column.key]).text(column.unit, column.digits)
    return f"**{text}**" if winners.get(column.key) == row["method"] else text


def published_markdown(figures: Sequence[Mapping[str, Any]]) -> str:
    """Published figures as a table."""
    rows = [[f["method"], f["title"], f"{f['value']:g}", f["source"]] for f in figures]
    return markdown_table(["method", "figure", "value", "source"], rows)
