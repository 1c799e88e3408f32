"""Device configuration files (CiA 306).

The objects that were changed, for the tools of other makers.
"""

from __future__ import annotations

from profiles.address import CanopenAddress
from profiles.eds import DATA_TYPES
from profiles.plain import plain
from profiles.schema import Profile

__all__ = ["dcf"]

_DATA_TYPE = {name: number for number, name in sorted(DATA_TYPES.items())}


def dcf(profile: Profile, values: dict[str, int], node: int | None) -> str:
    """A DCF with the raw `values` of some parameters of a CANopen drive, by name.

    `node` : its node number; left out where it is None
    """
    found: dict[tuple[int, int], str] = {}
    for name, raw in values.items():
        parameter = profile.parameters[name]
        at = parameter.address
        assert isinstance(at, CanopenAddress)
        digits = int(at.type[1:]) // 4
        found[at.index, at.sub] = "\n".join(
            (
                f"ParameterName={plain(parameter.title)}",
                "ObjectType=0x7",
                f"DataType=0x{_DATA_TYPE[at.type]:04X}",
                "AccessType=rw",
                "PDOMapping=0",
                f"ParameterValue=0x{raw & (1 << 4 * digits) - 1:0{digits}X}",
            )
        )
    indices = sorted({index for index, _ in found})
    vendor, product = profile.identity.vendor or "0x0", profile.identity.product or "0x0"
    lines = [
        "[FileInfo]", "FileVersion=1", "FileRevision=0", "EDSVersion=4.0",
        "CreatedBy=tworelay", f"Description={plain(profile.title)}", "",
        "[DeviceInfo]", f"VendorNumber={plain(vendor)}", f"ProductName={profile.name}",
        f"ProductNumber={plain(product)}", "",
    ]  # fmt: skip
    if node is not None:  # the standard's own spelling
        lines += ["[DeviceComissioning]", f"NodeID={node}", ""]
    lines += ["[MandatoryObjects]", "SupportedObjects=0", ""]
    lines += ["[OptionalObjects]", "SupportedObjects=0", "", "[ManufacturerObjects]"]
    lines += [f"SupportedObjects={len(indices)}"]
    lines += [f"{number}=0x{index:04X}" for number, index in enumerate(indices, 1)]
    for index in indices:
        subs = sorted(sub for i, sub in found if i == index)
        if subs == [0]:
            lines += ["", f"[{index:04X}]", found[index, 0]]
            continue
        lines += [
            "", f"[{index:04X}]", f"ParameterName={index:04X}h", "ObjectType=0x9",
            f"SubNumber={len(subs)}",
        ]  # fmt: skip
        for sub in subs:
            lines += ["", f"[{index:04X}sub{sub:X}]", found[index, sub]]
    return "\n".join(lines) + "\n"
