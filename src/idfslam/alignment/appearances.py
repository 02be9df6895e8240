"""The image pyramids of views and the landmarks of keyframes, each computed once and kept as long as its images are in memory."""

from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from idfslam.alignment.constants import MASKED
from idfslam.alignment.image_pyramid import pyramid
from idfslam.alignment.landmarks import Landmarks, landmarks
from idfslam.alignment.sighting import Appearance
from idfslam.alignment.small_image import pixels_of, small_image
from idfslam.config import AlignmentConfig
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_images import Images
from idfslam.sensing.vignette import Vignette


class Appearances:
    """Computes and keeps what images are compared by."""

    def __init__(self, config: AlignmentConfig) -> None:
        self.config = config
        self.vignette: Vignette | None = None  # is taken out of images before their brightness is compared
        self._appearances: WeakKeyDictionary[Images, Appearance] = WeakKeyDictionary()
        self._landmarks: WeakKeyDictionary[Keyframe, Landmarks] = WeakKeyDictionary()
        self._pixels: WeakKeyDictionary[Keyframe, Landmarks] = WeakKeyDictionary()

    def of(self, view: Keyframe) -> Appearance:
        """A view's image pyramid."""
        return self.of_images(view.images, view.camera)

    def as_taken(self, view: Keyframe) -> Appearance:
        """The same for its images before rectification."""
        return self.of_images(view.taken, view.camera)

    def of_images(self, images: Images, camera: Camera) -> Appearance:
        """The same for some images of a camera."""
        if images not in self._appearances:
            height, levels = self.config.image_height, self.config.image_levels
            of_view = pyramid(images.colour, camera, height=height, levels=levels, vignette=self.vignette)
            self._appearances[images] = Appearance(of_view, sight(images), camera)
        return self._appearances[images]

    def landmarks(self, keyframe: Keyframe) -> Landmarks:
        """A keyframe's landmarks. Its pyramid is released: other images are compared with the landmarks alone."""
        if keyframe not in self._landmarks:
            levels = self.of(keyframe).levels
            self._landmarks[keyframe] = landmarks(levels, keyframe.depth, count=self.config.landmarks)
            self.release(keyframe)
        return self._landmarks[keyframe]

    def pixels(self, keyframe: Keyframe) -> Landmarks:
        """The pixels of a keyframe's small image that have depth. Its pyramid is released."""
        if keyframe not in self._pixels:
            self._pixels[keyframe] = pixels_of(small_image(self.of(keyframe)), with_depth=True)
            self.release(keyframe)
        return self._pixels[keyframe]

    def take_out(self, vignette: Vignette | None) -> None:
        """Takes this vignetting out of all images from now on."""
        self.vignette = vignette
        self._appearances.clear()
        self._landmarks.clear()
        self._pixels.clear()

    def forget(self, keyframe: Keyframe) -> None:
        """Forgets the landmarks and pixels of a keyframe whose images were replaced."""
        self._landmarks.pop(keyframe, None)
        self._pixels.pop(keyframe, None)

    def release(self, view: Keyframe) -> None:
        """Frees a view's image pyramid. It is computed again when it is needed again."""
        self._appearances.pop(view.images, None)


def sight(images: Images) -> Tensor:
    """(H, W) [m] how far a view sees: its depth, and nothing behind what moves."""
    if images.moving is None:
        return images.depth
    return images.depth.masked_fill(torch.from_numpy(images.moving).to(images.depth.device), MASKED)
