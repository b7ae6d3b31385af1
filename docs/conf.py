"""The manual: Sphinx with MyST-NB. Built by `sphinx-build -W --keep-going -n docs build/docs`."""

import os
import sys
from functools import partial
from importlib import metadata
from pathlib import Path

from jupyter_cache.executors import utils as executors

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import reference_pages  # noqa: E402  (found beside this file)

reference_pages.write(HERE / "reference" / "generated")

project = "transopt"
author = "The transopt developers"
copyright = f"2026, {author}"  # noqa: A001
release = version = metadata.version("transopt")

extensions = ["myst_nb", "mathml"]
html_math_renderer = "mathml"  # the package's own, so that formulas need no network
exclude_patterns = ["reference/generated"]
html_theme = "furo"
html_title = f"transopt {release}"
html_static_path = ["static"]
html_css_files = ["pages.css"]
language = "en"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
# A page that runs writes files: it does so in an empty folder of its own. It calls the commands that are installed
# beside this Python, which need not be on the path, and their tables are as wide as a page.
nb_execution_in_temp = True
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
os.environ["COLUMNS"] = "90"
os.environ["BASH_ENV"] = str(HERE / "bash_env")
os.environ["MATPLOTLIBRC"] = str(HERE / "matplotlibrc")  # how their figures look
# What a command prints comes out of a notebook in pieces of 100 bytes. They are joined as they are: MyST-NB's own way
# of doing so puts a line break between them, and it has no option for the other one.
executors.executenb = partial(executors.executenb, coalesce_streams=True)
# Fences of a shell session, of a scene and of output carry comments and prompts that no lexer has to accept.
suppress_warnings = ["misc.highlighting_failure"]
linkcheck_timeout = 20
linkcheck_retries = 2
