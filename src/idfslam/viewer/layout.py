"""The layout of the viewer's window."""

from typing import Any


def layout(name: str) -> Any:
    """The layout of the viewer: a large scene, the images to its right, plots below."""
    import rerun.blueprint as rrb

    eye = rrb.EyeControls3D(kind="orbital", position=(0.8, -2.4, -2.3), look_target=(0.1, 0.0, 1.9), eye_up=(0, -1, 0))
    scene = rrb.Spatial3DView(
        origin="world",
        contents=["$origin/**", "- $origin/camera/image/depth"],  # the points of the depth image would hide the mesh
        name=name,
        eye_controls=eye,
        background=(16, 18, 22),
        line_grid=False,
    )
    image = "world/camera/image"
    colour, depth = (rrb.Spatial2DView(origin=image, contents=f"$origin/{kind}", name=kind) for kind in ("colour", "depth"))
    legend = rrb.PlotLegend(corner="lefttop")  # covers the oldest values
    losses = rrb.TimeSeriesView(origin="losses", name="losses", plot_legend=legend)
    milliseconds = rrb.TimeSeriesView(origin="milliseconds", name="milliseconds a frame", plot_legend=legend)
    status = rrb.Tabs(rrb.StateTimelineView(origin="status", name="status of frames"), rrb.TextLogView(origin="events", name="loops"))
    above = rrb.Horizontal(scene, rrb.Vertical(colour, depth), column_shares=[3, 1])
    below = rrb.Horizontal(losses, milliseconds, status)
    return rrb.Blueprint(
        rrb.Vertical(above, below, row_shares=[3, 1]),
        rrb.TimePanel(state="collapsed", timeline="frame", play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )
