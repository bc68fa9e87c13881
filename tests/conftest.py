"""What holds for every test: examples that are drawn are the same in every run, unless asked
otherwise.
"""

import os

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
# HYPOTHESIS_PROFILE=searching draws anew in every run and prints how to repeat what fails.
settings.register_profile("searching", deadline=None, print_blob=True)
settings.load_profile(
    "repeatable" if os.environ.get("CI") else os.environ.get("HYPOTHESIS_PROFILE", "repeatable")
)
