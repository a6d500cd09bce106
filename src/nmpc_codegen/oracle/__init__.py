"""The oracle verifies independently: cost, rows and KKT residuals of any trajectory, and IPOPT's solution."""
