"""How fast dcgrid is, and how its power flow compares with other libraries."""
