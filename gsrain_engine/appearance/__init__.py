"""Clear views in, rainy views out."""
