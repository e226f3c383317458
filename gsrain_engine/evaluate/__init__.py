"""How close what is made is to what cameras see."""
