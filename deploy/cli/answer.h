// Answers the questions of the Python commands (deploy/python/craftfleet/analysis/programs.py) about configurations,
// run folders and textures, whose formats only the C++ code knows.

#pragma once

#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet {

// `question` is a JSON object; the answer is one, too, on a line of its own:
//   {"config": TEXT, "path": NAME, "textures": DIGEST, "check_envs": BOOL} -> the complete configuration of the run as
//     "config", its "identity", equal for runs that may be averaged, its "settings" apart from the agent, the agent's
//     "defaults" of them, and its "steps_to_train". "path" names the text in errors; all but "config" may be left out.
//   {"folder": DIR, "steps": N} -> "begun", "steps" and "finished" of the run in the folder: whether it has a
//     checkpoint, the steps of the newest one, and whether it has reached N steps and its final evaluation is complete.
//   {"textures_in": DIR} -> "digest" of the textures; "": those that come with the programs.
//   {"machine": true} -> "threads" that a run has by default.
// {"error": MESSAGE}: the question or what it asks about is invalid.
std::string Answer(absl::string_view question);

}  // namespace craftfleet
