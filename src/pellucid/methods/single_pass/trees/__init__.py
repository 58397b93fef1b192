"""Binary cluster trees over lights and over irradiance samples, which both algorithms walk (AWB08 section 4.2)."""
