"""Processes that are forked from one parent, which has imported what they share.

The supervisor asks the parent for a process (`client`), the parent forks it (`parent`), and the child takes the rights,
the environment and the command that are its own (`child`). The child is a child of the supervisor in the end, which
waits for it as for any other: the parent may be killed or replaced while its children go on.
"""
