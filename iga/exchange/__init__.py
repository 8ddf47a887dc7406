"""Files for other programs: Bezier cells for ParaView, Bezier extraction for solvers; written whole or not at all."""
