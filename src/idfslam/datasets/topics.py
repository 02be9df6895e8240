"""The topics of a ROS recording that the user names."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

from idfslam.errors import ConfigError


@dataclass(frozen=True)
class Topics:
    """Names of topics. None: the topic is detected; poses are read only if named."""

    colour: str | None = None
    depth: str | None = None
    camera_info: str | None = None  # of the colour camera
    poses: str | None = None  # the ground truth

    @classmethod
    def of(cls, names: Mapping[str, str | None] | None) -> "Topics":
        """From a mapping; raises ConfigError for other keys."""
        allowed = [field.name for field in fields(cls)]
        if unknown := [key for key in names or {} if key not in allowed]:
            raise ConfigError(f"topics: {', '.join(unknown)} unknown, expected {', '.join(allowed)}")
        return cls(**{key: _normal(name) for key, name in (names or {}).items() if name})


def _normal(name: str) -> str:
    """The name with a leading slash, as bags list it."""
    return "/" + name.strip("/")
