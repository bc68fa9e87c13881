"""What figures are told for, and what their sentences say again and again."""

# What a figure is told for; "joints": those of whose contact forces the state keeps the impulse.
LOOPS, SPEEDS, CONTACTS, SURFACES, WHOLE = "loops", "speeds", "contacts", "surfaces", "mechanism"
JOINTS, LOADS, RUBBING, COLLARS = "joints", "loads and drives", "joints that rub", "collars"
TOUCHING = "joints that always touch"
UNHELD = "joints that always touch and that nothing holds along their axis"
SLIDING = "journals that nothing holds along their axis"
AGAIN = "with steps a quarter as long or shorter (tolerances 256 times tighter)"
# Or where worn surfaces are updated half as often.
OR_WORN = f"{AGAIN}, or worn surfaces updated half as often,"
TIGHTER = "take shorter steps or a tight integrator.Adaptive"
OR_OFTEN = f"{TIGHTER}, and save more often where surfaces wear"
