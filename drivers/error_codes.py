"""What the error codes of emergencies and of 603Fh say, in words (CiA 301, 7.2.7.

CiA 402-2, annex A).
"""

from __future__ import annotations

__all__ = ["is_of_communication", "register_words", "words"]

# the code itself, or all that begin with the same digits
_CODES = {
    0x1000: "an error without a kind",
    0x2110: "short circuit or earth leakage at the input",
    0x2211: "too much current inside the drive",
    0x2220: "continuous overcurrent inside the drive",
    0x2310: "continuous overcurrent at the motor",
    0x2311: "overcurrent at the motor, first case", 0x2312: "overcurrent at the motor, second case",
    0x2320: "short circuit or earth leakage at the motor",
    0x2330: "earth leakage at the motor", 0x2340: "short circuit between motor phases",
    0x2350: "the thermal model of the motor is at its limit (I2t)",
    0x3110: "mains overvoltage", 0x3120: "mains undervoltage", 0x3130: "a mains phase is missing",
    0x3210: "the DC link has too much voltage: a braking resistor, or slower ramps",
    0x3220: "the DC link has too little voltage: is the mains on?",
    0x3330: "field circuit", 0x4110: "it is too hot around the drive",
    0x4120: "it is too cold around the drive", 0x4210: "the drive is too hot",
    0x4220: "the drive is too cold", 0x4310: "the motor or power stage is too hot",
    0x5112: "supply of the electronics, 24 V", 0x5113: "supply of the electronics, 5 V",
    0x5210: "measurement circuit", 0x5441: "contactor", 0x5442: "contactor or input for STO",
    0x5530: "non-volatile memory", 0x6010: "the drive's software restarted (its own watchdog)",
    0x6320: "a parameter is wrong", 0x7110: "brake chopper", 0x7113: "brake chopper is overloaded",
    0x7121: "the motor is blocked", 0x7122: "motor, or its commutation",
    0x7305: "incremental encoder 1", 0x7306: "incremental encoder 2", 0x7310: "speed",
    0x7320: "position", 0x7380: "position sensor", 0x7500: "communication with something inside",
    0x8100: "communication", 0x8110: "CAN messages were lost",
    0x8120: "the node's CAN is error passive",
    0x8130: "heartbeat of the master lost, or guarding",
    0x8140: "the node was bus-off and has recovered",
    0x8150: "two nodes have the same COB-ID", 0x8210: "a PDO was too short",
    0x8220: "a PDO was too long",
    0x8230: "a destination of an MPDO is missing", 0x8240: "SYNC has a wrong length",
    0x8250: "a PDO did not come in time", 0x8311: "too much torque", 0x8312: "too much torque",
    0x8331: "too little torque", 0x8400: "speed control: too fast, or not as it was told",
    0x8500: "position control", 0x8600: "positioning", 0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "synchronisation lost: jitter, or another period than 60C2h says",
    0x8800: "winding control", 0x8900: "process data", 0x8A00: "control",
}  # fmt: skip
# by the first digits, where the code itself is the vendor's
_CLASSES = {
    0x21: "current at the input", 0x22: "current inside the drive", 0x23: "current at the motor",
    0x2: "current", 0x31: "mains voltage", 0x32: "voltage inside the drive", 0x33: "output voltage",
    0x3: "voltage", 0x41: "ambient temperature", 0x42: "temperature of the drive",
    0x4: "temperature",
    0x5: "hardware of the drive", 0x61: "software of the drive", 0x62: "user software",
    0x63: "its parameters", 0x6: "software of the drive", 0x71: "power", 0x72: "measurement",
    0x73: "sensor", 0x7: "an additional module", 0x81: "communication", 0x82: "protocol",
    0x8: "monitoring", 0x90: "an external error: an input tells it", 0xF0: "additional functions",
    0xFF: "of the vendor's own",
}  # fmt: skip
_REGISTER = (
    "generic", "current", "voltage", "temperature", "communication", "profile", "reserved",
    "vendor",
)  # fmt: skip


def words(code: int) -> str:
    """What a code says; '' where no standard knows it."""
    found = _CODES.get(code)
    if found is not None:
        return found
    by_class = _CLASSES.get(code >> 8) if code >> 12 else None
    return by_class or _CLASSES.get(code >> 12) or ""


def is_of_communication(code: int) -> bool:
    """Whether a code may say that the master has fallen silent; the vendor's own, and none, may."""
    return code == 0 or code >> 8 in (0x75, 0x81, 0x82, 0xFF) or not words(code)


def register_words(register: int) -> str:
    """Kinds of errors that 1001h tells."""
    return ", ".join(name for bit, name in enumerate(_REGISTER) if register >> bit & 1)
