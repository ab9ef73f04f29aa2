"""What every test relies on: one thread per process and no screen."""

import os
import signal

# Several test processes share the cores; this has to be said before numpy and torch are loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["SDL_VIDEODRIVER"] = "dummy"

# A job in the background of a shell ignores Ctrl-C, and what it starts inherits that; some tests
# send it to programs that they have started.
signal.signal(signal.SIGINT, signal.default_int_handler)

pytest_plugins = ["stored_episodes"]
