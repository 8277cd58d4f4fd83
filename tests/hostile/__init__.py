"""What a hostile user, disk or clock does to it: nothing is lost, and nothing is silently wrong."""
