"""JSON lines, commands, MQTT, terminal, Prometheus."""
