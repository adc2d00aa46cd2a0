"""`obu papers motion-conflict`: the smart tachograph's speed check, Sensors 18, 1583, 2018."""
