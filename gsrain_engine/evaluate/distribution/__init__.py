"""How far two sets of pictures are from each other as distributions: FID and KID, and how sure they are."""
