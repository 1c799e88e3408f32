"""Who a drive says it is, and whom a profile is for."""

from __future__ import annotations

from profiles.strict import Strict

__all__ = ["NOBODY", "NO_SERIAL", "Identity", "IdentityMatch"]

NO_SERIAL = "", "0x00000000"  # of drives that tell none


class IdentityMatch(Strict):
    """What the drive must say about itself (object 1018h, or Modbus FC 43/14).

    A profile without any of these matches every drive of its bus and is used only when asked for
    by name. `asked` false: the drive does not know FC 43/14; who it is stands in the parameters
    `product_code`, `revision_code` and `serial_number`, those that there are.
    """

    vendor: str | None = None
    product: str | None = None
    revisions: tuple[str, ...] = ()
    asked: bool = True

    def accepts(self, identity: Identity) -> bool:
        """Whether `identity` is one of the drives that this profile is for."""
        return (
            (self.vendor is None or self.vendor == identity.vendor)
            and (self.product is None or self.product == identity.product)
            and (not self.revisions or identity.revision in self.revisions)
        )

    @property
    def empty(self) -> bool:
        """Whether nothing is asked for."""
        return self.vendor is None and self.product is None and not self.revisions


class Identity(Strict):
    """What a drive said about itself. Numbers are written as in CiA 301: `0x0000009A`."""

    vendor: str
    product: str
    revision: str
    serial: str

    def __str__(self) -> str:
        named = (
            ("", self.vendor),
            ("", self.product),
            ("rev ", self.revision),
            ("serial ", self.serial),
        )
        return " ".join(f"{what}{text}" for what, text in named if text) or "does not say who it is"


NOBODY = Identity(vendor="", product="", revision="", serial="")
