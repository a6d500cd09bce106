"""Independent verification: cost, rows and KKT residuals of any trajectory, and IPOPT's solution of the same NLP."""
