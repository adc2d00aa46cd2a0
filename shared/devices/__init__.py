"""Access to devices: byte streams, CAN interfaces, and the Xbus protocol."""
