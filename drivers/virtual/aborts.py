"""SDO abort codes (CiA 301, table 22), and an access that ends with one."""

from __future__ import annotations

from drivers.virtual.states import DenialReason

__all__ = ["DENIALS", "Abort"]

ABORT_TOGGLE = 0x05030000
ABORT_BLOCK_SIZE = 0x05040002
ABORT_COMMAND = 0x05040001
ABORT_WRITE_ONLY = 0x06010001
ABORT_READ_ONLY = 0x06010002
ABORT_NO_OBJECT = 0x06020000
ABORT_NOT_MAPPABLE = 0x06040041
ABORT_PDO_LENGTH = 0x06040042
ABORT_LENGTH = 0x06070010
ABORT_NO_SUB = 0x06090011
ABORT_RANGE = 0x06090030
ABORT_STATE = 0x08000022


class Abort(Exception):
    """The SDO server refuses an access, with a code of CiA 301."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:08X}h")
        self.code = code


DENIALS = {
    DenialReason.NO_OBJECT: ABORT_NO_OBJECT,
    DenialReason.READ_ONLY: ABORT_READ_ONLY,
    DenialReason.RANGE: ABORT_RANGE,
    DenialReason.STATE: ABORT_STATE,
}
