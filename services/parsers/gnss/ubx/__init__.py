"""UBX of u-blox: framing, decoding, and the dialogues that configure a receiver."""
