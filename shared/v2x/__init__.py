"""ETSI ITS-G5 messages: UPER codec of the CAM, GeoNetworking and BTP headers, and ITS time."""
