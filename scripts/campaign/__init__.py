"""Faulty recordings made from unspoiled ones, and how `calibrate` is scored on them."""
