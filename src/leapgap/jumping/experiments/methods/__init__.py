"""Landing methods, a file each; configured instances are listed in ``conf/land``."""
