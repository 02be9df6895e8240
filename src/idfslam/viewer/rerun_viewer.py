"""Shows a run live with rerun, in a window or a browser, and records it as recording.rrd (package rerun-sdk)."""

import os
import platform
import subprocess
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.errors import ConfigError
from idfslam.frame import Frame, FrameResult, Status
from idfslam.geometry.camera import Camera
from idfslam.viewer import rerun_program
from idfslam.viewer.coloured_path import STATUS_COLOURS, coloured_strips
from idfslam.viewer.frustums import frustums
from idfslam.viewer.layout import layout
from idfslam.viewer.rerun_program import LOOPBACK, PORT, RECORDING, Place
from idfslam.viewer.slam_view import ClosedLoop, SlamView
from idfslam.viewer.time_budget import Budget

# The four shares add up to 5.5 % of the run's time. A larger share shows its part more often and slows the run down by as much.
_SHARES = {"camera": 0.01, "images": 0.015, "graph": 0.01, "mesh": 0.02}
_MESH_RESOLUTION = 0.05  # [m] cells of the mesh during the run; larger: coarser, and shown more often
_MAX_ROWS = 240  # [px] height of the images; larger: sharper, and a larger file
_PLOT_BATCH = 30  # frames whose losses and times are sent in one call; larger: cheaper, and the plots lag behind by as many frames
_MAX_TAIL = 30  # frames; a path of more frames since the last keyframe makes the whole trajectory due; larger: corrections show later
_KEYFRAME, _COVISIBLE, _LOOP = (70, 140, 240), (120, 170, 240, 70), (240, 60, 200)  # RGB or RGBA, 0 to 255; larger: lighter
_TRAJECTORY, _TAIL = "world/trajectory", "world/trajectory/newest"


class RerunViewer:
    """Shows a run with rerun in `place` and records it as recording.rrd.

    Camera, images, graph and mesh each have a share of the run's time, 5.5 % together. An update that does not fit into its share is
    skipped, and a later one replaces it. Raises ConfigError if rerun is not installed, if there is no display for a window, and if a port
    is in use.
    """

    files = frozenset({RECORDING})

    def __init__(self, place: Place, *, port: int = PORT, host: str = LOOPBACK) -> None:
        """host: the address of this machine that page and data listen on (`web`); 0.0.0.0 stands for all."""
        os.environ.setdefault("CI", "true")  # no usage statistics: see rerun_program.environment
        self._rr = rerun_program.rerun()
        self.place, self.port, self.host = place, port, host
        self._page: subprocess.Popen[bytes] | None = None  # the program that serves the page
        if place == "web":
            rerun_program.check_ports(port, host)
        if place == "window" and not rerun_program.has_display():
            raise ConfigError("there is no display to open a window on; `--viewer web` shows the run in a browser, on any machine")
        self._recorded: Any = None
        self._budgets: dict[str, Budget] = {}
        self._start: float | None = None  # [s] time stamp of the first frame
        self._camera: Camera | None = None
        self._tail: list[tuple[NDArray[np.float64], Status]] = []  # positions from the last one of the trajectory drawn to the newest
        self._status: Status | None = None
        self._loops: set[tuple[int, int]] = set()
        self._calls: dict[str, int] = {}  # number of calls of each stage that have been plotted
        self._plots: dict[str, list[tuple[int, float, float]]] = defaultdict(list)  # frame, [s] and value; not sent yet
        self._poses: list[tuple[int, float, NDArray[np.float64]]] = []  # frame, [s] and T_wc; not sent yet

    @contextmanager
    def opened(self, folder: Path, name: str) -> Iterator[None]:
        self._budgets = {part: Budget(share) for part, share in _SHARES.items()}
        part = folder / f".part-{RECORDING}"
        rr = self._rr
        self._recorded = rr.RecordingStream("idf-slam")
        self._recorded.set_sinks(rr.FileSink(part), *self._sinks(), default_blueprint=layout(name))
        self._recorded.send_recording_name(name)
        self._log("world", rr.ViewCoordinates.RDF, static=True)  # the first camera: x right, y down, z forward
        states = [str(status.value) for status in Status]
        self._log("status", rr.StateConfiguration(values=states, colors=[STATUS_COLOURS[status] for status in Status]), static=True)
        try:
            yield
        finally:
            self._send_pending()
            self._recorded.flush()
            self._recorded.disconnect()
            if self._page is not None:
                self._page.kill()
                self._page.wait()
            os.replace(part, folder / RECORDING)

    def frame(self, frame: Frame, result: FrameResult, slam: SlamView) -> None:
        seconds = self._set_time(frame)
        self._show_status(result)
        self._plot(frame.index, seconds, result, slam)
        if self._budgets["images"].allows():
            with self._budgets["images"].spending():
                self._show_images(frame)
        self._tail.append((result.T_wc[:3, 3], result.status))
        new_loops = self._log_new_loops(slam)
        due = result.keyframe or len(self._tail) > _MAX_TAIL
        if new_loops or (due and self._budgets["graph"].allows()):
            with self._budgets["graph"].spending():
                self._show_graph(slam)
        if self._budgets["camera"].allows():
            with self._budgets["camera"].spending():
                self._show_camera(result)
        else:
            self._poses.append((frame.index, seconds, result.T_wc))
        if self._budgets["mesh"].allows() and slam.stored_keyframes():
            with self._budgets["mesh"].spending():
                self._show_mesh(slam.mesh(_MESH_RESOLUTION))

    def finish(self, slam: SlamView, mesh: trimesh.Trimesh) -> None:
        self._log_new_loops(slam)
        self._show_graph(slam)
        self._show_mesh(mesh)

    def address(self) -> str:
        """The address of the live view for a browser."""
        return f"http://{self._name()}:{self.port}/?url={quote(self._data_address(), safe='')}"

    def _data_address(self) -> str:
        return f"rerun+http://{self._name()}:{self.port + 1}/proxy"

    def _name(self) -> str:
        """The name under which a browser finds this machine."""
        if self.host == LOOPBACK:
            return "localhost"
        return platform.node() if self.host == "0.0.0.0" else self.host

    def _sinks(self) -> list[Any]:
        """Where the data is sent besides the file."""
        rr = self._rr
        if self.place == "web":
            sink = rr.GrpcServerSink(bind_ip=self.host, port=self.port + 1, cors_allow_origin=[rerun_program.pages(self.port)])
            command = rerun_program.serve_command(self.port, self.host, self._data_address())
            self._page = subprocess.Popen(command, env=rerun_program.environment(), stdout=subprocess.DEVNULL)
            return [sink]
        if self.place == "window":
            rr.spawn(connect=False, executable_path=rerun_program.program())
            return [rr.GrpcSink()]
        return []

    def _log(self, entity: str, value: Any, *, static: bool = False) -> None:
        self._recorded.log(entity, value, static=static)

    def _set_time(self, frame: Frame) -> float:
        """Assigns everything that is logged from now on to this frame. Returns its time [s] since the first frame."""
        self._start = frame.timestamp if self._start is None else self._start
        seconds = frame.timestamp - self._start
        self._recorded.set_time("frame", sequence=frame.index)
        self._recorded.set_time("recorded", duration=seconds)
        return seconds

    def _show_status(self, result: FrameResult) -> None:
        """Logs the status if it has changed."""
        if result.status is not self._status:
            self._status = result.status
            self._log("status", self._rr.StateChange(state=result.status.value))

    def _plot(self, frame: int, seconds: float, result: FrameResult, slam: SlamView) -> None:
        """Collects the losses and the milliseconds of each stage for this frame, and sends those of many frames at once."""
        for name, loss in result.losses.items():
            self._plots[f"losses/{name}"].append((frame, seconds, loss))
        for stage, ms in slam.timings.items():
            self._plots[f"milliseconds/{stage}"].append((frame, seconds, sum(ms[self._calls.get(stage, 0) :])))
            self._calls[stage] = len(ms)
        if max(map(len, self._plots.values()), default=0) >= _PLOT_BATCH:
            self._send_pending()

    def _send_pending(self) -> None:
        """Sends the collected plots, and the poses of frames whose camera was not shown."""
        rr = self._rr
        for entity, rows in self._plots.items():
            self._send(entity, rows, rr.Scalars.columns(scalars=[value for _, _, value in rows]))
        if self._poses:
            T_wc = np.array([T for _, _, T in self._poses])
            self._send("world/camera", self._poses, rr.Transform3D.columns(translation=T_wc[:, :3, 3], mat3x3=T_wc[:, :3, :3]))
        self._plots.clear()
        self._poses.clear()

    def _send(self, entity: str, rows: Sequence[tuple[int, float, Any]], columns: Any) -> None:
        """Sends the values of many frames in one call. rows: frame, [s] and value."""
        frames, seconds, _ = zip(*rows)
        times = [self._rr.TimeColumn("frame", sequence=frames), self._rr.TimeColumn("recorded", duration=seconds)]
        self._recorded.send_columns(entity, times, columns)

    def _show_images(self, frame: Frame) -> None:
        """Colour as JPEG and depth in millimetres as PNG, both reduced to at most `_MAX_ROWS` rows."""
        step = max(1, -(-frame.camera.height // _MAX_ROWS))
        camera = frame.camera.resized(frame.camera.width // step, frame.camera.height // step)
        size = (camera.width, camera.height)
        if camera != self._camera:
            self._camera = camera
            pinhole = self._rr.Pinhole(image_from_camera=camera.matrix().numpy(), resolution=size, image_plane_distance=0.3)
            self._log("world/camera/image", pinhole, static=True)
        colour = cv2.resize(frame.colour, size, interpolation=cv2.INTER_AREA)
        jpeg = cv2.imencode(".jpg", np.round(colour[..., ::-1] * 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
        self._log("world/camera/image/colour", self._rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
        depth = cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST)  # interpolated depth would be points in empty space
        png = cv2.imencode(".png", np.round(depth * 1000).clip(0, 65535).astype(np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
        encoded = self._rr.EncodedDepthImage(png.tobytes(), media_type="image/png", meter=1000.0, colormap="turbo")
        self._log("world/camera/image/depth", encoded)

    def _show_camera(self, result: FrameResult) -> None:
        """The camera's pose, and its path since the whole trajectory was last drawn."""
        self._log("world/camera", self._rr.Transform3D(translation=result.T_wc[:3, 3], mat3x3=result.T_wc[:3, :3]))
        if len(self._tail) > 1:
            positions, statuses = zip(*self._tail)
            self._show_path(_TAIL, np.array(positions), statuses)

    def _log_new_loops(self, slam: SlamView) -> bool:
        """Logs a line for each loop that is new. Returns whether there is one."""
        new = _pairs(slam.loops()) - self._loops
        self._loops |= new
        keyframes = slam.stored_keyframes() if new else ()
        for a, b in sorted(new):
            self._log("events", self._rr.TextLog(f"loop closed between frames {keyframes[a].index} and {keyframes[b].index}"))
        return bool(new)

    def _show_graph(self, slam: SlamView) -> None:
        """Keyframes of the reported submap, their covisibility, loops, and the path of all frames, at their present poses."""
        keyframes = slam.stored_keyframes()
        T_wk = np.array([keyframe.T_wk for keyframe in keyframes]).reshape(-1, 4, 4)
        placed = [i for i, keyframe in enumerate(keyframes) if keyframe.submap == 0]
        self._show_lines("world/keyframes", frustums(T_wk[placed], [keyframes[i].camera for i in placed]), _KEYFRAME, width=1)
        covisible = {(j, i) for i in placed for j in keyframes[i].covisible if j < i}
        for kind, pairs, colour, width in (("covisible", covisible, _COVISIBLE, 1), ("loop", _pairs(slam.loops()), _LOOP, 3)):
            self._show_lines(f"world/graph/{kind}", [T_wk[list(pair), :3, 3] for pair in sorted(pairs)], colour, width=width)
        positions, statuses = slam.trajectory()[:, :3, 3], slam.statuses()
        self._show_path(_TRAJECTORY, positions, statuses)
        self._tail = [(positions[-1], statuses[-1])]
        self._show_lines(_TAIL, [], _KEYFRAME, width=1)

    def _show_path(self, entity: str, positions: NDArray[np.float64], statuses: Sequence[Status]) -> None:
        """A line through `positions` (N, 3), coloured by the frames' statuses."""
        strips, kinds = coloured_strips(positions, statuses)
        self._show_lines(entity, strips, [STATUS_COLOURS[kind] for kind in kinds], width=3)

    def _show_lines(self, entity: str, strips: Any, colours: Any, *, width: float) -> None:
        """Lines, each (N, 3) [m]. width: [points of the screen]."""
        lines = self._rr.LineStrips3D(strips, colors=colours, radii=self._rr.Radius.ui_points(width / 2))
        self._log(entity, lines)

    def _show_mesh(self, mesh: trimesh.Trimesh) -> None:
        """The mesh. Its faces are shown from their front only, so that a view from outside looks through the walls into the room."""
        assert isinstance(mesh.visual, trimesh.visual.ColorVisuals)
        colours = mesh.visual.vertex_colors[:, :3]
        vertices, faces = mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)
        self._log(
            "world/mesh", self._rr.Mesh3D(vertex_positions=vertices, triangle_indices=faces, vertex_colors=colours, face_rendering="front")
        )


def _pairs(loops: Sequence[ClosedLoop]) -> set[tuple[int, int]]:
    """The pairs of keyframes that loops connect."""
    return {(loop.a, loop.b) for loop in loops}
