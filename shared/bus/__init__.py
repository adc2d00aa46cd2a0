"""The bus: MQTT client, codec and envelope."""
