"""How a camera turns the light of a scene into the colours of one image: recorded = V(r) gain (scene + offset), for each channel.

The scene's colours are those of the recording's first keyframe without vignetting: its gain is 1 and its offset 0.
"""

from dataclasses import dataclass

from torch import Tensor

from idfslam.geometry.camera import Camera
from idfslam.sensing.vignette import Vignette


@dataclass(frozen=True)
class Light:
    """Exposure of one image, and the vignetting of its recording."""

    gain: Tensor  # (3,) float32
    offset: Tensor  # (3,) float32, in the scene's units
    vignette: Vignette | None = None  # None: there is none

    def scene(self, colour: Tensor, uv: Tensor, camera: Camera) -> Tensor:
        """The scene's colours (N, 3) in [0, 1] that were recorded as `colour` (N, 3) at pixels (N, 2)."""
        if self.vignette is not None:
            colour = colour / self.vignette.share(uv.to(colour.dtype), camera)[:, None]
        return (colour / self.gain.to(colour) - self.offset.to(colour)).clamp(0, 1)

    def recorded(self, scene: Tensor, uv: Tensor, camera: Camera) -> Tensor:
        """The colours (N, 3) in [0, 1] in which the image shows the scene's colours (N, 3) at pixels (N, 2)."""
        colour = (scene + self.offset.to(scene)) * self.gain.to(scene)
        if self.vignette is not None:
            colour = colour * self.vignette.share(uv.to(scene.dtype), camera)[:, None]
        return colour.clamp(0, 1)
