// Registers every plugin of the library when it is loaded.
#include "plugin/lifecycle.h"

mjPLUGIN_LIB_INIT(leglab) {
  leglab::plugin::register_backlash();
  leglab::plugin::register_command_path();
  leglab::plugin::register_cylinder();
  leglab::plugin::register_joint_friction();
  leglab::plugin::register_sensor();
  leglab::plugin::register_spring_damper();
  leglab::plugin::register_supply();
}
