"""Mechanisms as files: scenes as YAML or JSON, and what other programs keep in URDF and MJCF."""
