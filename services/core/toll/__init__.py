"""Tracks vehicles from their CAM messages, decides their lanes and follows their passages through a toll plaza."""
