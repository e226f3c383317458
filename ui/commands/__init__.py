"""The commands of menus, keys and palette."""
