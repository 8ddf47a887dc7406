"""Studies: one module per question; tables, rates, figures and their baselines."""
