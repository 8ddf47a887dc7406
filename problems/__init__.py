"""Heat conduction and linear elasticity: data, exact solutions, benchmark cases."""
