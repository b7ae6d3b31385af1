"""The manual: Sphinx with MyST-NB. Built by `sphinx-build -W --keep-going -n docs build/docs`."""

import sys
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import reference_pages  # noqa: E402  (found beside this file)

reference_pages.write(HERE / "reference" / "generated")

project = "transopt"
author = "The transopt developers"
release = version = metadata.version("transopt")

extensions = ["myst_nb"]
exclude_patterns = ["reference/generated"]
html_theme = "furo"
html_title = f"transopt {release}"
language = "en"

myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 60
# Fences of a shell session, of a scene and of output carry comments and prompts that no lexer has to accept.
suppress_warnings = ["misc.highlighting_failure"]
linkcheck_timeout = 20
linkcheck_retries = 2
