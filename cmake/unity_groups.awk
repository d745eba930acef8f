# Which sources of a target may be compiled as one unit: `awk -v most=N -f unity_groups.awk FILE...` prints a line per file,
# its group and the file, groups of at most N.
#
# Names in anonymous namespaces belong to one file, and must not meet another file's words: two files share a group only when
# no word of one is such a name of the other. So a unity build means what the build of single files means, and whoever writes
# a file need not think of it. It relies on clang-format: what is declared in a namespace begins in the first column.

function declare(name) {
  if (name != "" && !((FILENAME, name) in declared)) {
    declared[FILENAME, name] = 1
    names[FILENAME] = names[FILENAME] " " name
  }
}

FNR == 1 { files[++count] = FILENAME; anonymous = 0; in_enum = 0 }

/^namespace \{$/ { anonymous = 1; next }
/^\}  \/\/ namespace$/ { anonymous = 0; next }

{
  line = $0
  sub(/\/\/.*/, "", line)
  rest = line
  while (match(rest, /[A-Za-z_][A-Za-z0-9_]*/)) {
    words[FILENAME, substr(rest, RSTART, RLENGTH)] = 1
    rest = substr(rest, RSTART + RLENGTH)
  }
}

# Enumerators without a scope are names as well.
anonymous && /^enum [^c]/ { in_enum = 1 }
in_enum {
  rest = line
  while (match(rest, /k[A-Z][A-Za-z0-9_]*/)) {
    declare(substr(rest, RSTART, RLENGTH))
    rest = substr(rest, RSTART + RLENGTH)
  }
  if (line ~ /}/) in_enum = 0
}

# What another file may say as well.
anonymous && /^using [^=]*;/ { next }

anonymous && /^(struct|class|union|enum|using) / {
  n = split(line, part, /[ :;{=]+/)
  declare(part[2] == "class" || part[2] == "struct" ? part[3] : part[2])
  next
}

# MATCHER_P(Name, ...) and its like
anonymous && /^(MATCHER|ACTION|DEFINE_)[A-Z_0-9]*\(/ {
  sub(/^[^(]*\(/, "", line)
  sub(/[,)].*/, "", line)
  declare(line)
  next
}

# A function's name stands before the first parenthesis that follows a name, a variable's before = [ { or ;
anonymous && /^[A-Za-z_]/ && !/^(TEST|TYPED_TEST|INSTANTIATE|template|namespace|friend|static_assert)/ {
  gsub(/"[^"]*"/, "", line)
  while (gsub(/<[^<>]*>/, "", line)) {}
  if (match(line, /[A-Za-z_][A-Za-z0-9_]*[ ]*[(=\[{;]/)) {
    name = substr(line, RSTART, RLENGTH)
    before = substr(line, 1, RSTART - 1)
    sub(/[ ]*[(=\[{;]$/, "", name)
    if (before !~ /::$/) declare(name)
  }
}

function meet(one, other, part, n, i) {
  n = split(names[one], part, " ")
  for (i = 1; i <= n; ++i)
    if ((other, part[i]) in words) return 1
  return 0
}

END {
  for (f = 1; f <= count; ++f) {
    file = files[f]
    for (group = 1; group <= groups; ++group) {
      free = size[group] < most
      for (i = 1; free && i <= size[group]; ++i)
        if (meet(file, member[group, i]) || meet(member[group, i], file)) free = 0
      if (free) break
    }
    if (group > groups) groups = group
    member[group, ++size[group]] = file
    print group, file
  }
}
