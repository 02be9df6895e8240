"""Models of the sensor."""
