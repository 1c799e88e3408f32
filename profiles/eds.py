"""EDS and DCF files of CANopen drives (CiA 306), read as they are out there.

Files of real drives break the standard in many small ways. What can be understood is mended, and
each mending is reported with its line; what is no EDS is refused.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from profiles.errors import ProfileError
from profiles.files import contents

__all__ = ["DATA_TYPES", "Eds", "EdsEntry", "Mended", "read_eds"]

_LARGEST = 5_000_000  # bytes
_MOST_MENDED = 10_000

# CiA 301, table 44: what a profile can carry
DATA_TYPES: dict[int, str] = {
    0x01: "u8", 0x02: "i8", 0x03: "i16", 0x04: "i32", 0x05: "u8", 0x06: "u16", 0x07: "u32",
    0x08: "f32",
    0x15: "i64", 0x1B: "u64",
}  # fmt: skip
_ACCESS = {
    "ro": "ro", "const": "ro", "wo": "wo", "rw": "rw", "rwr": "rw", "rww": "rw",
}  # fmt: skip
_VARIABLE = 0x7
_MOST_SUBS = 254
_IDENTITY = 0x1018

_OBJECT = re.compile(r"([0-9a-f]{1,4})(?:\s*sub\s*([0-9a-f]{1,2}))?", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(?:0x[0-9a-f]+|\d+)", re.IGNORECASE)
_NODE_ID = re.compile(r"\$NODEID", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Mended:
    """Something that was understood in spite of how it is written, and its line (from 1)."""

    line: int
    text: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.text}"


@dataclass(frozen=True, slots=True)
class EdsEntry:
    """One variable of the object dictionary.

    Attributes
    ----------
    index, sub : of CiA 301
    name : as the file has it
    type : scalar type of a profile, None for texts, domains and floats
    access : ro, rw or wo
    default, value : DefaultValue and, in a DCF, ParameterValue; None where there is no plain number
    low, high : LowLimit and HighLimit, raw
    mappable : whether it may be put into a PDO
    line : of its section
    """

    index: int
    sub: int
    name: str
    type: str | None
    access: str
    default: int | None
    value: int | None
    low: int | None
    high: int | None
    mappable: bool
    line: int


@dataclass(frozen=True, slots=True)
class Eds:
    """What a file says.

    Attributes
    ----------
    vendor_name, product_name : texts
    vendor, product, revision : numbers of object 1018h, by itself or else by the header; None where
        they are not said
    differs : what the header says else
    entries : by (index, sub)
    records : names of arrays and records, by index
    mended : in the order of the file
    """

    vendor_name: str
    product_name: str
    vendor: int | None
    product: int | None
    revision: int | None
    differs: tuple[str, ...]
    entries: dict[tuple[int, int], EdsEntry]
    records: dict[int, str]
    mended: tuple[Mended, ...]

    def entry(self, index: int, sub: int = 0) -> EdsEntry | None:
        """A variable, None where the file has none."""
        return self.entries.get((index, sub))

    def value(self, index: int, sub: int = 0) -> int | None:
        """What it is set to, or delivered with; None where there is no plain number."""
        there = self.entry(index, sub)
        if there is None:
            return None
        return there.default if there.value is None else there.value


@dataclass
class _Section:
    """One section: its keys in lower case, each with its text and line."""

    name: str
    line: int
    keys: dict[str, tuple[str, int]] = field(default_factory=dict)

    def text(self, key: str) -> str:
        return self.keys.get(key.lower(), ("", self.line))[0]


class _Reader:
    def __init__(self, where: str) -> None:
        self.where = where
        self.mended: list[Mended] = []

    def mend(self, line: int, text: str) -> None:
        if len(self.mended) < _MOST_MENDED:
            self.mended.append(Mended(line, text))

    # -- text --------------------------------------------------------------------------------------

    def decode(self, data: bytes) -> str:
        if data.startswith(b"\xef\xbb\xbf"):
            self.mend(1, "a byte order mark")
            data = data[3:]
        try:
            return data.decode("utf-8")
        except UnicodeDecodeError as error:
            line = data[: error.start].count(b"\n") + 1
            self.mend(line, f"byte 0x{data[error.start]:02X} is not UTF-8: read as Windows-1252")
            return data.decode("cp1252", "replace")

    def sections(self, text: str) -> dict[str, _Section]:
        found: dict[str, _Section] = {}
        current: _Section | None = None
        for number, raw in enumerate(re.split(r"\r\n|\n|\r", text), 1):
            line = raw.strip().strip("\0\x1a")
            if not line or line[0] in ";#":
                continue
            if line.startswith("["):
                current = self._open(line, number, found)
            elif "=" not in line:
                self.mend(number, f"'{line:.40}' has no '=': left out")
            elif current is None:
                self.mend(number, f"'{line:.40}' stands before the first section: left out")
            else:
                key, _, value = line.partition("=")
                name = key.strip().lower()
                if name in current.keys:
                    self.mend(number, f"{key.strip():.40} comes twice: the first is taken")
                    continue
                current.keys[name] = (value.strip(), number)
        return found

    def _open(self, line: str, number: int, found: dict[str, _Section]) -> _Section:
        name, bracket, rest = line[1:].partition("]")
        if not bracket:
            self.mend(number, f"'{line:.40}' lacks its ']'")
        elif rest.strip() and rest.strip()[0] not in ";#":
            self.mend(number, f"'{rest.strip():.40}' behind a section's name: left out")
        key = " ".join(name.lower().split())
        if key in found:
            self.mend(number, f"section [{name.strip():.40}] comes twice: they are put together")
            return found[key]
        found[key] = _Section(name.strip(), number)
        return found[key]

    # -- values ------------------------------------------------------------------------------------

    def number(self, section: _Section, key: str) -> int | None:
        """A plain number; None for nothing, a text, or one that depends on the node."""
        text, line = section.keys.get(key.lower(), ("", section.line))
        if not text or _NODE_ID.search(text):
            return None
        bare = re.split(r"[;#]", text)[0].strip().rstrip("hH") if "0x" not in text.lower() else text
        bare = re.split(r"[;#\s]", bare.strip())[0] if bare.strip() else ""
        if not _NUMBER.fullmatch(bare):
            return self._odd_number(section, key, text, line)
        if bare != text:
            self.mend(line, f"{key}={text:.40} is read as {bare}")
        sign, digits = (-1, bare[1:]) if bare[0] == "-" else (1, bare.lstrip("+"))
        if digits.lower().startswith("0x"):
            return sign * int(digits, 16)
        if len(digits) > 1 and digits[0] == "0":
            self.mend(line, f"{key}={text:.40} is read as decimal")
        return sign * int(digits) if len(digits) < 40 else None

    def _odd_number(self, section: _Section, key: str, text: str, line: int) -> int | None:
        try:
            value = float(text)
        except ValueError:
            value = None
        if value is not None and abs(value) < 1e18 and value == int(value):
            self.mend(line, f"{key}={text:.40} is read as {int(value)}")
            return int(value)
        if key.lower() not in ("defaultvalue", "parametervalue"):
            self.mend(line, f"[{section.name}] {key}={text:.40} is no number: left out")
        return None

    # -- objects -----------------------------------------------------------------------------------

    def entry(self, section: _Section, index: int, sub: int) -> EdsEntry | None:
        kind = self.number(section, "ObjectType")
        data_type = self.number(section, "DataType")
        if kind not in (None, _VARIABLE) or (data_type is None and not section.text("AccessType")):
            return None
        access = section.text("AccessType").lower()
        if access not in _ACCESS:
            what = "is missing" if not access else f"'{access:.20}' is unknown"
            self.mend(section.line, f"[{section.name}] AccessType {what}: taken as read only")
        name = DATA_TYPES.get(data_type or 0)
        low, high, default, value = (
            self._as_typed(self.number(section, key), name)
            for key in ("LowLimit", "HighLimit", "DefaultValue", "ParameterValue")
        )
        return EdsEntry(
            index, sub, section.text("ParameterName"), name, _ACCESS.get(access, "ro"), default,
            value, low, high, self.number(section, "PDOMapping") == 1, section.line,
        )  # fmt: skip

    def compact(
        self, section: _Section, index: int, sections: dict[str, _Section]
    ) -> list[EdsEntry]:
        """The sub-objects of an array that is written in short (CiA 306, 4.6.3.3)."""
        count = self.number(section, "CompactSubObj")
        if not count:
            return []
        key = f"{index:04x}"
        names, values = sections.get(f"{key}name"), sections.get(f"{key}value")
        found = [
            EdsEntry(index, 0, "Highest sub-index", "u8", "ro", count, None, None, None,
                     mappable=False, line=section.line)
        ]  # fmt: skip
        for sub in range(1, min(count, _MOST_SUBS) + 1):
            one = _Section(f"{index:04X}sub{sub:X}", section.line, dict(section.keys))
            one.keys["objecttype"] = ("0x7", section.line)
            if names is not None and names.text(str(sub)):
                one.keys["parametername"] = (names.text(str(sub)), names.line)
            if values is not None and values.text(str(sub)):
                one.keys["parametervalue"] = (values.text(str(sub)), values.line)
            entry = self.entry(one, index, sub)
            if entry is not None:
                found.append(entry)
        return found

    @staticmethod
    def _as_typed(value: int | None, name: str | None) -> int | None:
        """A negative number that the file writes as its bits, 0x80000000 for an i32."""
        if value is None or name is None or name[0] != "i":
            return value
        bits = int(name[1:])
        if 1 << (bits - 1) <= value < 1 << bits:
            return value - (1 << bits)
        return value


def read_eds(path: Path) -> Eds:
    """Read an EDS or DCF file; raises ProfileError for what is none."""
    try:
        data = contents(path, _LARGEST)
    except OSError as error:
        raise ProfileError(f"{path}: cannot be read: {error.strerror or error}") from None
    return parse_eds(data, str(path))


def parse_eds(data: bytes, where: str) -> Eds:
    """An EDS or DCF from bytes; `where` names the file in messages."""
    reader = _Reader(where)
    sections = reader.sections(reader.decode(data))
    device = sections.get("deviceinfo")
    if device is None:
        raise ProfileError(
            f"{where}: has no [DeviceInfo] section: this is no EDS or DCF of a device"
            + (" but a list of objects" if "1000" in sections else "")
        )
    entries: dict[tuple[int, int], EdsEntry] = {}
    records: dict[int, str] = {}
    for key, section in sections.items():
        match = _OBJECT.fullmatch(key)
        if match is None:
            continue
        index, sub = int(match[1], 16), int(match[2] or "0", 16)
        if len(match[1]) != 4:
            reader.mend(section.line, f"[{section.name}] is read as object {index:04X}h")
        entry = reader.entry(section, index, sub)
        for one in [entry] if entry is not None else reader.compact(section, index, sections):
            entries.setdefault((one.index, one.sub), one)
        if entry is None and not match[2]:
            records[index] = section.text("ParameterName")
    if not entries:
        raise ProfileError(f"{where}: describes no object: this is no EDS or DCF of a drive")
    _listed(reader, sections, entries)
    who, differs = _who(reader, device, entries)
    reader.mended.sort(key=lambda item: item.line)
    return Eds(
        device.text("VendorName"),
        device.text("ProductName"),
        *who,
        differs,
        entries,
        records,
        tuple(reader.mended),
    )


def _who(
    reader: _Reader, device: _Section, entries: dict[tuple[int, int], EdsEntry]
) -> tuple[tuple[int | None, int | None, int | None], tuple[str, ...]]:
    """Vendor, product and revision, by 1018h before the header; and where both differ."""
    found: list[int | None] = []
    differs = []
    for sub, key in enumerate(("VendorNumber", "ProductNumber", "RevisionNumber"), 1):
        entry, said = entries.get((_IDENTITY, sub)), reader.number(device, key)
        there = None
        if entry is not None:
            there = entry.default if entry.value is None else entry.value
        there = there or None  # 0 is delivered where nobody has filled it in
        if there is not None and said is not None and there != said:
            differs.append(f"{key} is {said:X}h in [DeviceInfo], and {there:X}h in 1018h:{sub:02X}")
        found.append(said if there is None else there)
    return (found[0], found[1], found[2]), tuple(differs)


_LISTS = ("mandatoryobjects", "optionalobjects", "manufacturerobjects")


def _listed(
    reader: _Reader, sections: dict[str, _Section], entries: dict[tuple[int, int], EdsEntry]
) -> None:
    """Say which listed objects have no section, and which lists miscount."""
    there = {index for index, _ in entries} | {
        int(m[1], 16) for key in sections if (m := _OBJECT.fullmatch(key))
    }
    for name in _LISTS:
        section = sections.get(name)
        if section is None:
            continue
        listed = [
            (index, line)
            for key, (_, line) in section.keys.items()
            if key.isdigit() and (index := reader.number(section, key)) is not None
        ]
        count = reader.number(section, "SupportedObjects")
        if count is None:
            count = reader.number(section, "Supported Objects")
        if count is not None and count != len(listed):
            reader.mend(
                section.line, f"[{section.name}] counts {count} objects and lists {len(listed)}"
            )
        for index, line in listed:
            if index not in there:
                reader.mend(line, f"object {index:04X}h is listed and not described")
