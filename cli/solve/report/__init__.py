"""The report of `obu solve`: plots, tables, exports."""
