"""What the virtual drive says about itself on Modbus (FC 43/14)."""

from __future__ import annotations

__all__ = ["PRODUCT", "REVISION", "VENDOR"]

VENDOR = "tworelay"
PRODUCT = "virtual drive"
REVISION = "1.0"
