"""The machine and the versions of a measurement."""

import platform
from typing import Any

from idfslam import __version__
from idfslam.compute.host import cores, processor


def machine() -> dict[str, Any]:
    """Processor, cores, GPU, system, and the versions that decide how it computes."""
    import torch

    return {
        "processor": processor(),
        "cores": cores(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "system": platform.platform(),
        "python": platform.python_version(),
        "idf-slam": __version__,
        "torch": torch.__version__,
    }
