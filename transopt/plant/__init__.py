"""Models of haptic devices: the acceleration of the stylus as a function of the motor's current or voltage.

A scene states the device; this package builds its continuous-time model and the matrices of the optimal-control
problem. "The seed" in these files is Fiene, Kuchenbecker, Niemeyer 2006, "Event-Based Haptic Tapping with Grip Force
Compensation".

Frame and signs, here and everywhere above: z is the stylus position along the surface normal, positive out of the
object, with the surface at z = 0. Contact is at t = 0, with dz/dt = -v for an incoming speed v > 0. A positive
current pushes outwards, and a positive acceleration decelerates the incoming stylus.

The nominal motion z_nom is the motion of the user's hand alone, with z_nom = 0 and dz_nom/dt = -v at contact. The
models describe the deviation y = z - z_nom that the current adds. It starts at rest, and so do the models.
"""
