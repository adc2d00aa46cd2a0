"""Security of ITS messages (TS 103 097, IEEE 1609.2, TS 102 941): envelopes, certificates, trust lists, signatures.

`envelope` reads what a packet states and checks no signature; `verifier` does, against what `trust` has read from
files. `signatures` and what imports it need `cryptography`.
"""
