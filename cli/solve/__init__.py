"""What `obu solve` makes of a solution: errors, metrics, tables, plots. Nothing here touches a file or a clock."""
