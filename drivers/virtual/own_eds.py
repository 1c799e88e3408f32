"""The EDS that a virtual drive carries in object 1021h."""

from __future__ import annotations

import struct

from drivers.virtual.mirror import Entry

__all__ = ["own_eds"]

_DATA_TYPE = {"b": 2, "h": 3, "i": 4, "B": 5, "H": 6, "I": 7, "q": 0x15, "Q": 0x1B}


def own_eds(
    objects: dict[tuple[int, int], Entry], identity: tuple[int, int, int], name: str
) -> bytes:
    """CiA 306 text of an object dictionary."""
    vendor, product, revision = identity
    lines = [
        "[FileInfo]", "FileName=virtual.eds", "FileVersion=1", "FileRevision=0", "EDSVersion=4.0",
        "", "[DeviceInfo]", "VendorName=tworelay", f"VendorNumber=0x{vendor:08X}",
        f"ProductName={name}",
        f"ProductNumber=0x{product:08X}", f"RevisionNumber=0x{revision:08X}",
    ]  # fmt: skip
    records = {index for index, sub in objects if sub}
    for index in sorted(records):
        lines += ["", f"[{index:04X}]", f"ParameterName={index:04X}h", "ObjectType=0x9"]
        lines += [f"SubNumber={1 + max(sub for i, sub in objects if i == index)}"]
    for (index, sub), entry in sorted(objects.items()):
        section = f"{index:04X}sub{sub:X}" if sub else f"{index:04X}"
        title = (entry.keys[0] if entry.keys else entry.name or section).replace("_", " ")
        bits = 8 * struct.calcsize("<" + entry.code)
        lines += [
            "", f"[{section}]", f"ParameterName={title}", "ObjectType=0x7",
            f"DataType=0x{_DATA_TYPE[entry.code]:04X}", f"AccessType={entry.access}",
            f"PDOMapping={1 if bits <= 32 else 0}",
        ]  # fmt: skip
    for section, title, kind in _COMMUNICATION:
        lines += ["", f"[{section}]", f"ParameterName={title}"]
        lines += ["ObjectType=0x9"] if not kind else ["ObjectType=0x7", f"DataType=0x{kind:04X}"]
        lines += ["AccessType=rw", "PDOMapping=0"] if kind else []
    return ("\r\n".join(lines) + "\r\n").encode("ascii", "replace")


_COMMUNICATION = (
    ("1010", "Store parameters", 0), ("1010sub1", "Save all parameters", 7),
    ("1016", "Consumer heartbeat time", 0), ("1016sub1", "Consumer heartbeat time 1", 7),
)  # fmt: skip
