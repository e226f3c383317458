"""The paper's comparison of transfers: one table and one figure of many methods on the same views."""
