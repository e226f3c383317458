"""The objects that a rendered picture shows, and the label files that say so."""
