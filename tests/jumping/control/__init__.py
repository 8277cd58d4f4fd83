"""Tests of leapgap.jumping.control."""
