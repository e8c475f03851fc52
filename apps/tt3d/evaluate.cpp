#include <iostream>

#include "commands.h"
#include "tt3d/evaluate.h"

namespace tt3d::cli {
namespace {

struct Arguments {
  EvaluateOptions options;
  std::string renderer = "builtin";
  std::string out;
  int64_t views = 100;
};

/// Other renderers are refused here, in one place, until they can be driven.
void check_renderer(const std::string& name) {
  if (name != "builtin") {
    throw InputError("--renderer " + name + ": this version renders with 'builtin' only");
  }
}

void evaluate(Arguments& a, const Common& common) {
  a.options.device = apply_common(common);
  check_renderer(a.renderer);
  a.options.seed = common.seed;
  const auto progress = make_progress(common);
  const EvalRecord record = evaluate_asset(a.options, *progress);
  write_record(record, a.out);
  if (common.json)
    std::cout << record_json(record);
  else
    print_record(record_json(record));
}

void render(const Arguments& a, const Common& common) {
  const at::Device device = apply_common(common);
  check_renderer(a.renderer);
  const auto progress = make_progress(common);
  render_to_folder(a.options.asset, a.options.view_distribution, a.views, a.options.size,
                   common.seed, a.out, *progress, device);
  std::cout << a.out << "\n";
}

void add_view_options(CLI::App& command, Arguments& a) {
  command.add_option("--views", a.views, "held-out random views")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command
      .add_option("--view-distribution", a.options.view_distribution, "ring, dome, sphere or paper")
      ->capture_default_str();
  command.add_option("--size", a.options.size, "pixels a side")
      ->check(CLI::Range(16, 8192))
      ->capture_default_str();
  command.add_option("--renderer", a.renderer, "builtin")->capture_default_str();
}

}  // namespace

void add_evaluate_commands(CLI::App& app, Common& common) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand("evaluate", "scores any GLB or OBJ against classifiers");
  command->add_option("ASSET", a->options.asset, "GLB or OBJ")->required();
  command->add_option("--target", a->options.target, "class: index, WordNet id or name")
      ->required();
  command->add_option("--victims", a->options.victims, "models that are scored")->required();
  command->add_option("--true-class", a->options.true_class, "class of the object");
  command->add_option("--clean", a->options.clean, "the object before the attack");
  command->add_option("--background", a->options.background, "white, #rrggbb or a folder")
      ->capture_default_str();
  command->add_option("--out", a->out, "FILE.json; FILE.csv is written beside it")->required();
  add_view_options(*command, *a);
  add_common_options(*command, common);
  command->callback([a, &common] {
    a->options.views = a->views;
    evaluate(*a, common);
  });

  CLI::App* picture = app.add_subcommand("render", "views of an asset as a NeRF-synthetic capture");
  picture->add_option("ASSET", a->options.asset, "GLB or OBJ")->required();
  picture->add_option("--out", a->out, "folder")->required();
  add_view_options(*picture, *a);
  add_common_options(*picture, common);
  picture->callback([a, &common] { render(*a, common); });
}

}  // namespace tt3d::cli
