"""Limits on the size and length of inputs.

They are far above what a tap needs, and low enough that the largest admitted input takes seconds and a gigabyte.
"""

# Time axis of a design: servo period, number of commands, and their product.
SHORTEST_DT_S, LONGEST_DT_S = 1e-6, 0.1
MOST_STAGES = 20_000
LONGEST_HORIZON_S = 10.0
LONGEST_DELAY_S = 1.0  # delay of an amplifier
LONGEST_LEAD_S = 0.02  # start of a waveform before contact; for longer an approach cannot be taken as straight

# Time considered after the waveform. The wall's responses there are a square matrix with one row for each tick.
LONGEST_AFTER_S = 0.5
MOST_AFTER = 3_000

# Grid of a library, and all commands in it.
MOST_NODES = 500  # speeds, and grips
MOST_COMMANDS = 2_000_000
MOST_STATES = 100  # states of a device
MOST_DEVICES = 50  # devices of a robust entry besides its own

# Recordings.
MOST_FILES = 1000  # files named by a scene, or matched by a pattern in it
MOST_SAMPLES = 4_000_000  # samples of all taps that a scene simulates
MOST_ROWS = 11_000_000  # rows of one recorded file: 10 s at 1 MHz, with a reserve
MOST_COLUMNS = 1000
MOST_IN_A_ROW = 1 << 16  # characters in a line of text

# Files, in bytes.
MOST_TEXT_BYTES = 1 << 20  # of a scene, a motor or a device
MOST_MODEL_BYTES = 1 << 24
MOST_FILE_BYTES = 1 << 26  # of a library
MOST_RECORD_BYTES = 1 << 28  # of a recording
MOST_UNPACKED_BYTES = 1 << 28  # of all arrays of one file
DEEPEST = 40  # nesting of tables and lists in TOML and JSON


def megabytes(size: float) -> str:
    """A size in bytes as text for messages."""
    return f"{size / 2**20:.3g} MB"
