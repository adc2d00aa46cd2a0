"""How long tests wait for what must come."""

# [s] What has not come by then hangs. Nothing is judged by it: tests run beside others, on any machine, and those that
# calculate have only the time that the others leave.
HANGS_S = 300.0
