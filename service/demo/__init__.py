"""The main job: a rotor of 100 blades streamed over HTTP, read back and held against the truth."""

from service.demo.run import run

__all__ = ["run"]
