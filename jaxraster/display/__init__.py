"""From linear light to a picture: exposure, tone curve, sRGB encoding, dither. The only stage that knows of sRGB.

In this order: `srgb_encode(tonemap(exposure(hdr, ev), name))`, then `dither` where the result becomes 8 bits. NaN
passes through all of it unchanged, so that whoever writes the file can count it; infinite light becomes white.
"""
