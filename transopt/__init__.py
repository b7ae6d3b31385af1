"""Design motor-current transients that make a virtual surface feel as hard as the real one.

One tap runs through the modules in this order::

    importers -> recording -> reference -> models -> discretise -> problem -> transcribe
    -> solvers -> certify -> replay -> build -> library -> export

Nothing is imported here, so that reading a library at run time never loads the optimiser.
"""
