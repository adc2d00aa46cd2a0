"""A module that starts a thread when it is imported, which no process that is to be forked may import."""

import threading

threading.Thread(target=threading.Event().wait, daemon=True).start()
