"""The suite, in which linear algebra has one thread: several would wait for each other, at twice the processor time.

The libraries read the number once, when numpy is loaded, so it is stated before any test is read.
"""

import os

from transopt.base.threads import one_thread

os.environ.update(one_thread(os.environ))
