"""Wire protocols of devices, one module each: framing, recognition, and the reasons of rejects. Pure: no I/O."""
