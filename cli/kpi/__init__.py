"""`obu kpi`: key performance indicators of a drive."""
