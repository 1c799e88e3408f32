"""What an adapter's error frames say of the bus, in plain words.

Error class in the identifier, details in the data, as Linux SocketCAN defines them
(linux/can/error.h); adapters of other kinds send error frames without details.
"""

from __future__ import annotations

__all__ = ["words"]

_CONTROLLER, _PROTOCOL, _NO_ACK, _BUS_OFF, _RESTARTED = 0x004, 0x008, 0x020, 0x040, 0x100
_OVERFLOW, _WARNING, _PASSIVE = 0x03, 0x0C, 0x30  # of data byte 1

BUS_OFF = (
    "the adapter is bus-off after too many errors: is the bit rate that of the bus, CAN-H and "
    "CAN-L not swapped or shorted, 120 ohm at both ends? (ip link set can0 down, then up, brings "
    "it back)"
)
PASSIVE = (
    "the adapter is error passive: nearly every frame goes wrong; is the bit rate that of the bus, "
    "120 ohm at both ends, the cable whole?"
)
NO_ACK = "nobody on the bus acknowledges: is the drive on, the cable in, the bit rate right?"
WARNING = "the adapter counts many bus errors: check termination, shield and cable"
OVERFLOW = "the adapter loses frames: this computer reads them too slowly"
DISTURBED = "frames are disturbed on the bus: check bit rate, termination and cable"


def words(identifier: int, data: bytes) -> str:
    """What to say of an error frame.

    '' where it is about nothing, or says that all is well again.
    """
    if identifier & _BUS_OFF:
        return BUS_OFF
    if identifier & _RESTARTED:
        return ""
    if identifier & _NO_ACK:
        return NO_ACK
    details = data[1] if identifier & _CONTROLLER and len(data) > 1 else 0
    for bits, text in ((_PASSIVE, PASSIVE), (_WARNING, WARNING), (_OVERFLOW, OVERFLOW)):
        if details & bits:
            return text
    if identifier & _CONTROLLER and details:
        return ""  # back to error active
    return DISTURBED
