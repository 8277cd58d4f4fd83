"""Tests of leapgap.control."""
