"""Commands of menus, keys and palette."""
