"""The application: a jumping quadruped that is planned, controlled, learned from and measured."""
