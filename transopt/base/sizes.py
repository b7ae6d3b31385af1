"""How large and how long inputs may be.

Far above what a tap needs, and low enough that the largest that is let in is handled within seconds and a gigabyte.
"""

# Time axis of a design: servo periods, number of commands, and what both come to.
SHORTEST_DT_S, LONGEST_DT_S = 1e-6, 0.1
MOST_STAGES = 20_000
LONGEST_HORIZON_S = 10.0
LONGEST_DELAY_S = 1.0  # of an amplifier
LONGEST_LEAD_S = 0.02  # of a waveform's start before contact: an approach is no straight line for longer

# What is looked at after the waveform. A wall's answers there to each other are a square matrix of so many rows.
LONGEST_AFTER_S = 0.5
MOST_AFTER = 3_000

# Grid of a library, and all commands in it.
MOST_NODES = 500  # of speeds, and of grips
MOST_COMMANDS = 2_000_000
MOST_STATES = 100  # of a device
MOST_DEVICES = 50  # that a robust entry serves besides its own

# Recordings.
MOST_FILES = 1000  # that a scene names, or a pattern in it
MOST_SAMPLES = 4_000_000  # of all taps that a scene simulates
MOST_ROWS = 11_000_000  # of one recorded file: 10 s at 1 MHz, and some more
MOST_COLUMNS = 1000
MOST_IN_A_ROW = 1 << 16  # characters of a line of text

# Files, in bytes.
MOST_TEXT_BYTES = 1 << 20  # of a scene, a motor or a device
MOST_MODEL_BYTES = 1 << 24
MOST_FILE_BYTES = 1 << 26  # of a library
MOST_RECORD_BYTES = 1 << 28  # of a recording
MOST_UNPACKED_BYTES = 1 << 28  # of all arrays of one file
DEEPEST = 40  # nesting of tables and lists in TOML and JSON


def megabytes(size: float) -> str:
    """A size in bytes as messages state it."""
    return f"{size / 2**20:.3g} MB"
