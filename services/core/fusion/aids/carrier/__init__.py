"""Aid: displacement of the antenna by carrier phases, in place of the receiver's velocity."""
