"""What ids and texts may look like, in requests and in files."""

from __future__ import annotations

ID_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._:@+\-]*$"
TEXT_PATTERN = r"^[^\x00-\x1f\x7f]+$"
