"""The ground floor: errors, files, signals, tables, figures, the console. Nothing here knows of haptics.

Every room of the package may import from here, and this room imports from none of them.
"""
